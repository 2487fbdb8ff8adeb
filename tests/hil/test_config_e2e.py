"""Data ids in a rig file: which profile takes what, and that no two messages share them."""

# ruff: noqa: E501 - a message on one line in the program stands on one line here

from pathlib import Path

import pytest
from test_config import BENCH, edited, load_text, mistakes

IDS = "data_ids = [17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, 252, 192, 54]\n"
IDS_OF_PRESSURES = IDS.replace(IDS[12:-2], "18, 183, 156, 20, 130, 119, 86, 189, 108, 252, 58, 80, 175, 255, 195, 53")


@pytest.mark.parametrize("data_id", [0, 0x1234, 0xFFFF])
def test_a_message_with_profile5_has_one_data_id(tmp_path: Path, data_id: int) -> None:
    change = ('e2e = "profile2"\n' + IDS, f'e2e = "profile5"\ndata_id = {data_id:#x}\n')
    message = load_text(tmp_path, edited(change)).bus.messages["Position"]
    assert (message.data_ids, message.all_data_ids) == ((), (data_id,))
    assert load_text(tmp_path, BENCH).bus.messages["Position"].all_data_ids[0] == 17


@pytest.mark.parametrize(
    ("table", "lines"),
    [
        ('e2e = "profile5"\n', ["data_id: missing; allowed: a whole number of 0..65535"]),
        ('e2e = "profile5"\ndata_id = 65536\n', ["data_id = 65536: must be less than or equal to 65535"]),
        ('e2e = "profile5"\ndata_id = -1\n', ["data_id = -1: must be greater than or equal to 0"]),
        ('e2e = "profile5"\ndata_id = 1\ndata_ids = [1]\n', ['data_ids = [1]: e2e = "profile5" has one data_id instead; remove the key']),
        ('e2e = "profile2"\ndata_id = 1\n' + IDS, ['data_id = 1: e2e = "profile2" has 16 data_ids instead; remove the key']),
        ('e2e = "none"\ndata_id = 1\n', ['data_id = 1: e2e = "none" has no data id; remove the key']),
    ],
)  # fmt: skip
def test_data_ids_that_do_not_fit_the_profile(tmp_path: Path, table: str, lines: list[str]) -> None:
    found = mistakes(tmp_path, edited(('e2e = "profile2"\n' + IDS, table)))
    assert found == [f"bus.messages.Position.{line}" for line in lines]


def test_two_messages_with_profile5_have_two_data_ids(tmp_path: Path) -> None:
    five = 'e2e = "profile5"\ndata_id = 7\n'
    text = edited(('e2e = "profile2"\n' + IDS, five), ('e2e = "profile2"\n' + IDS_OF_PRESSURES, five))
    assert mistakes(tmp_path, text) == [
        "bus.messages.PressureAB.data_id = 7: same number as Position; allowed: a number of its own"
    ]
    assert load_text(tmp_path, text.replace("data_id = 7", "data_id = 8", 1)).bus.messages["Position"].data_id == 8
