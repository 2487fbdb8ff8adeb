import sys
sys.path.insert(0, __file__.rsplit("/",1)[0])
import smoke
if "--warm-up" in sys.argv: smoke.compiled_function()
else: smoke.main()
