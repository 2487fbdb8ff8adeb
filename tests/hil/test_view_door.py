"""Who may talk to the page's server, and what an order looks like: strangers try both."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servohil.hil.telemetry.queryables import COMMANDS as KNOWN_TO_THE_RIG
from servohil.hil.view.door import DoorError, host_allowed, listen_address, origin_allowed, token_matches
from servohil.hil.view.orders import COMMANDS, Order, OrderError, parse_order


@pytest.mark.parametrize("host", ["127.0.0.1:8090", "localhost:8090", "localhost", "[::1]:8090", "192.168.1.7:8090"])
def test_our_own_page_comes_in_and_a_program_without_a_page_too(host: str) -> None:
    assert origin_allowed(f"http://{host}", host)
    assert origin_allowed(None, host)


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "", "http://127.0.0.1:9999", "http://127.0.0.1:8090.evil.example", "file://",
     "http://localhost:8090", "http://127.0.0.1:8090/", "http://evil.example#http://127.0.0.1:8090"],
)  # fmt: skip
def test_a_foreign_page_does_not(origin: str) -> None:
    assert not origin_allowed(origin, "127.0.0.1:8090")


@pytest.mark.parametrize("host", [None, "", "evil.example:8090", "localhost.evil.example", "127.0.0.1.evil.example",
                                  "[", "[::1", "a b", "127.0.0.1@evil.example"])  # fmt: skip
def test_a_name_that_was_pointed_here_does_not_come_in(host: str | None) -> None:
    assert not host_allowed(host)
    assert not origin_allowed(f"http://{host}", host)
    assert not origin_allowed(None, host)


@given(st.text(max_size=20) | st.none() | st.integers() | st.lists(st.text()))
def test_no_other_token_is_taken(given_token: object) -> None:
    assert not token_matches(given_token, "the-one-token-there-is")
    assert not token_matches(given_token, None)
    assert token_matches("the-one-token-there-is", "the-one-token-there-is")


@pytest.mark.parametrize(
    ("text", "operator", "found"),
    [
        ("127.0.0.1:8090", True, ("127.0.0.1", 8090)),
        ("localhost:0", True, ("127.0.0.1", 0)),
        ("[::1]:8090", True, ("::1", 8090)),
        ("0.0.0.0:80", False, ("0.0.0.0", 80)),
    ],
)
def test_addresses_to_listen_on(text: str, operator: bool, found: tuple[str, int]) -> None:
    assert listen_address(text, operator) == found


@pytest.mark.parametrize("text", ["8090", "127.0.0.1", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:65536", "rig:8090", ":1",
                                  "127.0.0.1:-1", "127.0.0.1:٣"])  # fmt: skip
def test_what_is_no_address_is_refused_with_what_is_allowed(text: str) -> None:
    with pytest.raises(DoorError, match="allowed"):
        listen_address(text, False)


@pytest.mark.parametrize("text", ["0.0.0.0:8090", "192.168.1.7:8090", "[::]:8090"])
def test_an_operators_page_stays_on_this_machine(text: str) -> None:
    with pytest.raises(DoorError, match="loopback"):
        listen_address(text, True)


def test_the_page_knows_every_command_of_the_rig() -> None:
    assert set(COMMANDS) == set(KNOWN_TO_THE_RIG)


def test_orders_are_understood() -> None:
    assert parse_order('{"id": 3, "token": "t", "cmd": "estop"}') == Order(3, "t", "cmd/estop")
    found = parse_order('{"id": 4, "token": "t", "param": "reference.amplitude_m", "value": 1}')
    assert found == Order(4, "t", "param/reference.amplitude_m", 1.0)
    assert parse_order('{"id": 0, "ask": "role"}') == Order(0, None, "")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not JSON"),
        ("[1]", "no object"),
        ("[" * 900, "not JSON"),
        ('{"cmd": "hold"}', "id"),
        ('{"id": true, "cmd": "hold"}', "whole number"),
        ('{"id": -1, "cmd": "hold"}', "whole number"),
        ('{"id": 1}', "allowed"),
        ('{"id": 1, "cmd": "hold", "param": "a.b"}', "allowed"),
        ('{"id": 1, "cmd": "shutdown"}', "enable, hold, disable, reset, estop, acknowledge"),
        ('{"id": 1, "cmd": "*"}', "allowed"),
        ('{"id": 1, "cmd": ["hold"]}', "allowed"),
        ('{"id": 1, "ask": "token"}', "allowed"),
        ('{"id": 1, "param": "reference.*", "value": 1}', "dotted name"),
        ('{"id": 1, "param": "a.b/../../cmd/enable", "value": 1}', "dotted name"),
        ('{"id": 1, "param": 7, "value": 1}', "dotted name"),
        ('{"id": 1, "param": "a.b", "value": "1"}', "finite"),
        ('{"id": 1, "param": "a.b", "value": true}', "finite"),
        ('{"id": 1, "param": "a.b", "value": null}', "finite"),
        ('{"id": 1, "param": "a.b", "value": NaN}', "finite"),
        ('{"id": 1, "param": "a.b", "value": 1e999}', "finite"),
        ('{"id": 1, "param": "a.b", "value": 1' + "0" * 400 + "}", "finite"),
        ('{"id": 1, "cmd": "hold", "x": "' + "y" * 2000 + '"}', "at most 1024"),
    ],
)
def test_what_is_no_order_is_refused_with_what_is_allowed(text: str, says: str) -> None:
    with pytest.raises(OrderError, match="allowed") as refused:
        parse_order(text)
    assert says in str(refused.value)
    assert len(str(refused.value)) < 400
    numbered = '"id": 1' in text and len(text) < 1024
    assert refused.value.id == (1 if numbered else None)


@given(st.text(max_size=60) | st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(["id", "token", "cmd", "param", "value", "ask", "x"]), inner, max_size=5)
).map(json.dumps))  # fmt: skip
def test_no_text_does_worse_than_be_refused(text: str) -> None:
    try:
        order = parse_order(text)
    except OrderError:
        return
    assert not set("*$#?/") & set(order.key.partition("/")[2])
