"""The dead band of an overlapped spool: what it lets through, and the command that makes up for it.

    opening = 0 within +-d, else what of the spool's travel exceeds d

The inverse jumps by 2 d at 0; here it rises over a small part of d instead, so that a command that trembles around zero
does not become a square wave of 2 d.
"""

from typing import Final

from numba import njit

RISE: Final = 0.1  # of the dead band


@njit(cache=True, nogil=True, error_model="numpy")
def opening(spool_v: float, dead_band_v: float) -> float:
    """What of the spool's travel lets oil through, V."""
    if spool_v > dead_band_v:
        return spool_v - dead_band_v
    if spool_v < -dead_band_v:
        return spool_v + dead_band_v
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def spool_for(opening_v: float, dead_band_v: float) -> float:
    """Where the spool must be for an opening, V; its inverse but for openings below a tenth of the dead band."""
    if dead_band_v <= 0.0:
        return opening_v
    rise = RISE * dead_band_v
    return opening_v + dead_band_v * min(max(opening_v / rise, -1.0), 1.0)
