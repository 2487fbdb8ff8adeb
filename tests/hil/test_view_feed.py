"""From a rig's messages to a page's: what is new, what is stale, what was lost, what a late page is told."""

import json

import numpy as np
import pytest
from view_messages import MS, batch, said

from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.view.block import decode_block
from servohil.hil.view.columns import NAMES
from servohil.hil.view.feed import Feed
from servohil.hil.view.freshness import STALE_NS, Freshness
from servohil.hil.view.lateness import BINS_PER_OCTAVE, FIRST_EDGE_NS, RecentLateness
from servohil.hil.view.rig_link import Message

S = 1_000_000_000


def test_nothing_is_fresh_before_the_first_cycle() -> None:
    freshness = Freshness()
    assert freshness.is_stale(0) and freshness.age_s(0) is None


def test_only_a_cycle_counter_that_moves_is_fresh() -> None:
    freshness = Freshness()
    assert not freshness.saw(7, 0, 10 * S)
    assert not freshness.is_stale(10 * S + STALE_NS) and freshness.is_stale(10 * S + STALE_NS + 1)
    freshness.saw(7, 0, 11 * S)  # a process that says the same again and again is frozen
    assert freshness.is_stale(11 * S)
    freshness.saw(8, 0, 11 * S)
    assert not freshness.is_stale(11 * S)
    assert STALE_NS <= S // 2


def test_age_is_that_at_publication_and_the_time_since() -> None:
    freshness = Freshness()
    freshness.saw(1, 30 * MS, S)
    assert freshness.age_s(S + 20 * MS) == pytest.approx(0.05)
    freshness.saw(2, -1, S)  # the rig does not know
    assert freshness.age_s(S + 20 * MS) == pytest.approx(0.02)


def test_a_counter_that_goes_back_is_a_new_run() -> None:
    freshness = Freshness()
    freshness.saw(100, 0, S)
    assert freshness.saw(1, 0, 2 * S)
    assert not freshness.is_stale(2 * S)


def test_new_cycles_become_one_block_and_the_newest_one_a_text() -> None:
    feed = Feed()
    block, text = feed.tick([batch(0, 10, 1, S, position_m=0.25), batch(10, 10, 2, S, position_m=0.5)], S)
    assert block is not None and text is not None
    columns = decode_block(block)
    assert columns.t_s[0] == 0.0 and columns.t_s[-1] == 0.019
    assert columns.values[NAMES.index("position_m"), -1] == 0.5
    content = json.loads(text)
    assert content["now"]["cycle"] == 19 and content["now"]["state"] == "ACTIVE"
    assert not content["stale"] and content["lost"] == 0
    assert feed.tick([], S + 10 * MS) == (None, None)
    block, text = feed.tick([], S + 700 * MS)
    assert block is None and text is not None and json.loads(text)["stale"]


def test_lost_batches_and_rubbish_are_counted_and_stop_nothing() -> None:
    feed = Feed()
    good = batch(0, 5, 1, S)
    rubbish = [Message("state", good.payload[:-3], S), Message("state", b"\xff" * 40, S)]
    rubbish += [Message("health", b"{", S), Message("event/info/x", b"[1]", S), Message("param/a.b", b"\xff", S)]
    rubbish.append(said("unheard/of", {}))
    feed.tick([good, *rubbish, batch(5, 5, 4, S)], S)
    assert feed.lost == 5 + 2
    assert json.loads(feed.greeting(S)[0])["now"]["cycle"] == 9


def test_a_batch_of_another_build_is_read_as_far_as_both_know() -> None:
    from servohil.hil.telemetry.servohil_pb2 import State, StateBatch

    state = State(cycle=3, t_ns=3 * MS, state=2, position_m=0.125)
    other = StateBatch(seq=1, samples=[state]).SerializeToString()
    block, text = Feed().tick([Message("state", other, S)], S)
    assert block is not None and decode_block(block).values[NAMES.index("position_m")].tolist() == [0.125]
    assert text is not None and json.loads(text)["now"]["state"] == "HOLD"


def test_a_page_that_is_opened_late_is_told_what_was_before() -> None:
    feed = Feed()
    event = {"severity": "alarm", "code": "leak", "text": "internal leak"}
    parameter = {"name": "reference.amplitude_m", "value": 0.1, "unit": "m", "min": 0, "max": 0.28}
    said_before = [said("event/alarm/leak", event), said("param/reference.amplitude_m", parameter)]
    said_before += [said("meta", {"rig": "bench", "fields": {}, "states": {}}), said("health", {"overruns": 3})]
    feed.tick([*said_before, batch(0, 100, 1, S)], S)
    feed.tick([batch(100, 100, 2, S), said("event/alarm/leak", event)], S)  # fetched again, heard once
    text, recent = feed.greeting(S)
    content = json.loads(text)
    assert content["events"] == [event] and content["parameters"] == [parameter]
    assert content["meta"] == {"rig": "bench"} and content["health"] == {"overruns": 3}
    assert content["columns"] == list(NAMES)
    assert recent is not None
    t_s = decode_block(recent).t_s
    assert t_s[0] == 0.0 and t_s[-1] == 0.199 and (np.diff(t_s) > 0).all()


def test_a_restart_forgets_the_old_run_and_asks_for_the_new_documents() -> None:
    feed = Feed()
    feed.tick([batch(5000, 10, 9, S), said("event/info/state", {"text": "old"})], S)
    assert feed.documents_old  # nothing was known before
    feed.documents_old = False
    feed.tick([batch(5010, 10, 10, S + 100 * MS)], S + 100 * MS)
    assert not feed.documents_old
    block, _ = feed.tick([batch(5020, 10, 11, S + 200 * MS), batch(0, 10, 1, S + 200 * MS)], 2 * S)
    assert feed.documents_old
    assert block is not None and decode_block(block).t_s[-1] == 0.009
    text, recent = feed.greeting(2 * S)
    assert recent is not None and decode_block(recent).t_s[0] == 0.0
    assert json.loads(text)["events"] == []


def test_events_that_are_asked_for_stand_in_their_order() -> None:
    feed = Feed()
    late, early = {"cycle": 9, "text": "late"}, {"cycle": 2, "text": "early"}
    feed.tick([said("event/alarm/leak", late), said("event/info/state", early)], S)
    assert json.loads(feed.greeting(S)[0])["events"] == [early, late]


def test_a_rig_that_comes_back_is_asked_again() -> None:
    feed = Feed()
    feed.tick([batch(0, 10, 1, S)], S)
    feed.documents_old = False
    feed.tick([batch(9000, 10, 2, 3 * S)], 3 * S)  # perhaps another run, which has got further than the last one
    assert feed.documents_old


def late(t_s: float, *lateness_us: float) -> np.ndarray:
    rows = np.zeros(len(lateness_us), SNAPSHOT)
    rows["t_ns"] = int(t_s * S)
    rows["lateness_ns"] = [int(us * 1e3) for us in lateness_us]
    return rows


def test_lateness_is_counted_in_its_bin_for_ten_seconds() -> None:
    recent = RecentLateness()
    recent.add(late(0.5, 0.0, 1.0, 16.0, 5e9))
    counts = recent.counts()
    assert counts[0] == 2 and counts[-1] == 1 and sum(counts) == 4
    at = counts.index(1)
    assert FIRST_EDGE_NS * 2 ** (at / BINS_PER_OCTAVE) <= 16_000 < FIRST_EDGE_NS * 2 ** ((at + 1) / BINS_PER_OCTAVE)
    recent.add(late(9.9, 100.0))
    assert sum(recent.counts()) == 5
    recent.add(late(10.1, 100.0))
    assert sum(recent.counts()) == 2
    recent.add(late(0.1, 100.0))  # a new run
    assert sum(recent.counts()) == 1
