"""The bus: frames described by a DBC, end-to-end protection, and ports. Knows nothing of what the signals are for.

Import what you need from the modules: `codec`, `open_port`, `bus_lock`, `in_process`, `frame`.
"""
