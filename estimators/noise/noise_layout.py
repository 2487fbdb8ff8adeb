"""Where the likelihood adaptation keeps its things: the own part of the arena, behind the common one."""

from numba.extending import register_jitable

from servohil.estimators.noise.noise_window import lane_count

# Scalars in front. Step numbers count ring entries since the reset.
(
    WRITTEN,  # entries written
    START,  # first entry of the pass under way
    NEXT,  # entry that the pass under way comes to next
    END,  # entry at which it ends
    OLDEST,  # no pass starts before this entry: the noise was another one then
    SAVE_AT,  # entry in front of which the next pass will start,
    SAVED,  # and the same once d and P were saved there, else -1
    MARK_AT,  # entry from which the pass is tested for a change of the noise,
    MARKED,  # and the same once sums, d and P were saved there, else -1
    HELD,  # passes that changed nothing
    CHANGES,  # times that older entries were dropped
    BY_DATA_R,  # 1: R starts from the data
    GROWN,  # logarithm by which Q and R have just grown together, before anything had been learnt
    SCALARS,
) = range(14)


@register_jitable
def entry_size(n: int, m: int) -> int:
    """Words of one ring entry: F, H, innovation, correction."""
    return n * n + m * n + m + n


@register_jitable
def noise_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts, relative to the own part, of

    - theta (n + m): natural logarithms of the diagonals of Q and R; their anchor; their standard deviations;
    - motion (n): mean square of what the model moves each state in a step; the largest yet;
    - last_y (2, m); curvature (m): sum of squares of second differences; counts (m); variances of P0 (n), at [20];
    - d and P saved where the next pass starts; d and P saved where the tested part begins;
    - gradient and information of the part that leaves the window, and of the part in front of the tested one;
    - memory: what left the window, as a linear term and information;
    - of the pass under way: d, P, gradient, information, totals, channels seen (m);
    - the ring.
    """
    lanes = lane_count(n, m)
    theta = SCALARS
    anchor = theta + n + m
    std = anchor + n + m
    motion = std + n + m
    largest = motion + n
    last_y = largest + n
    curvature = last_y + 2 * m
    counts = curvature + m
    first = counts + m
    saved = first + n
    marked = saved + n + n * n
    leaving = marked + n + n * n
    untested = leaving + lanes + lanes * lanes
    memory = untested + lanes + lanes * lanes
    d = memory + lanes + lanes * lanes
    p = d + n * lanes
    gradient = p + n * n * lanes
    information = gradient + lanes
    totals = information + lanes * lanes
    seen = totals + 3
    ring = seen + m
    return (
        theta, anchor, std, motion, largest, last_y, curvature, counts, saved, marked, leaving, untested, memory, d, p,
        gradient, information, totals, seen, ring, first,
    )  # fmt: skip


@register_jitable
def noise_size(n: int, m: int, ring: int) -> int:
    """Words of the own part."""
    return noise_offsets(n, m)[19] + ring * entry_size(n, m)


@register_jitable
def room_size(n: int, m: int) -> int:
    """Words of scratch that the adaptation takes."""
    lanes = lane_count(n, m)
    return n + m + max((n + 3) * lanes, (n + m) * (n + m + 2))
