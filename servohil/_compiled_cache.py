"""numba's disk cache, made safe for what we do with it: several processes, many functions of one name, models that
are edited.

- A cached function that calls a compiled function of another file does not notice an edit of that other file: numba
  looks at the caller's file alone, and would run the old model. A folder per hash of all compiled sources cannot be
  stale.
- numba tells functions of one name apart by counting them. Two processes may count two filters alike, and a third one,
  which loads both from disk, would then call one of them for the other. Here each process counts from a random number.
- numba numbers the files of one function's signatures, and two processes that save at the same moment may give one
  number twice: the code of one is then found under the signature of the other
  (https://github.com/numba/numba/issues/10128). Here a file is named after what it is the code for.
"""

import hashlib
import importlib.util
import itertools
import os
import secrets
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Final

ROOMS: Final = ("estimators", "control", "drivers", "hil", "sim_bench")
FIRST_NUMBER_BITS: Final = 60


def compiled_sources_hash(package: Path) -> str:
    """Hash of every source file under the rooms of `package` that mentions numba. 16 hex digits."""
    digest = hashlib.sha256()
    for room in ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            text = path.read_bytes()
            if b"numba" in text:
                digest.update(path.relative_to(package).as_posix().encode())
                digest.update(text)
    return digest.hexdigest()[:16]


def use_cache_of_these_sources() -> None:
    """Set NUMBA_CACHE_DIR to <base>/servohil-<hash>; base is NUMBA_CACHE_DIR where given, else the user's cache
    folder. Share it safely with other processes from the moment numba is imported, which is not done here: it takes
    half a second.
    """
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(home) / "servohil" / "numba")
    if base.name.startswith("servohil-"):  # inherited from a servohil parent process
        base = base.parent
    folder = str(base / f"servohil-{compiled_sources_hash(Path(__file__).parent)}")
    os.environ["NUMBA_CACHE_DIR"] = folder
    numba = sys.modules.get("numba")
    if numba is None:
        sys.meta_path.insert(0, _WhenNumbaIsImported())
    else:  # its configuration has been read already
        numba.config.CACHE_DIR = folder
        _share_safely()


def save_under_key(file: Any, key: Any, data: Any) -> None:
    """`IndexDataCacheFile.save` with a file name that belongs to the key alone.

    Of two processes that write the index at the same moment one loses its entry, and compiles again some other time.
    """
    name = file._data_name(int.from_bytes(hashlib.sha256(file._dump(key)).digest()[:8]))
    file._save_data(name, data)
    index = file._load_index()
    if index.get(key) != name:
        index[key] = name
        file._save_index(index)


def number_functions_from_a_random_place() -> None:
    """Where numba's count of functions, a part of the names of their symbols, goes on in this process."""
    from numba.core.bytecode import FunctionIdentity

    FunctionIdentity._unique_ids = itertools.count(secrets.randbits(FIRST_NUMBER_BITS))


def _share_safely() -> None:
    from numba.core.caching import IndexDataCacheFile

    IndexDataCacheFile.save = save_under_key
    number_functions_from_a_random_place()
    os.register_at_fork(after_in_child=number_functions_from_a_random_place)


class _WhenNumbaIsImported(MetaPathFinder):
    """Calls `_share_safely` at the end of the first import of numba."""

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "numba":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_share(module: ModuleType) -> None:
            execute(module)
            _share_safely()

        spec.loader.exec_module = execute_and_share  # type: ignore[method-assign]
        return spec
