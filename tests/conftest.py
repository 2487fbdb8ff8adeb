"""What every test may count on."""

import signal

# A shell that starts the tests in the background lets them ignore Ctrl-C, and every process that they start inherits
# that: the tests that send it would wait for ever.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
