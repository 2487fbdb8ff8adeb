"""Does the guest do what the tests on top of it take for granted? AF_CAN, python-can, numba from the warmed cache."""

import socket
import struct
import time

import numpy as np
from numba import njit
from numpy.typing import NDArray

CHANNEL = "vcan0"
FRAME = struct.Struct("=IB3x8s")  # struct can_frame of linux/can.h


@njit(cache=True)
def sum_of_squares(values: NDArray[np.float64]) -> float:
    """Something to compile. values (n,)."""
    total = 0.0
    for value in values:
        total += value * value
    return total


def compiled_function() -> None:
    """sum of k^2 for k < n is (n-1) n (2n-1) / 6."""
    assert sum_of_squares(np.arange(10.0)) == 285.0


def raw_sockets() -> None:
    """A frame sent on one AF_CAN socket arrives on another with its identifier and data."""
    with (
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender,
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as receiver,
    ):
        for end in (sender, receiver):
            end.bind((CHANNEL,))
            end.settimeout(5.0)
        sender.send(FRAME.pack(0x123, 4, b"\xde\xad\xbe\xef"))
        can_id, length, data = FRAME.unpack(receiver.recv(FRAME.size))
        assert (can_id, length, data[:4]) == (0x123, 4, b"\xde\xad\xbe\xef")


def python_can(count: int = 100) -> float:
    """`count` frames there and back; median round trip in seconds."""
    import can

    trips = []
    with can.Bus(CHANNEL, interface="socketcan") as here, can.Bus(CHANNEL, interface="socketcan") as there:
        for number in range(count):
            start = time.perf_counter()
            here.send(can.Message(arbitration_id=0x100 + number, data=[number, 1, 2], is_extended_id=False))
            echo = there.recv(5.0)
            assert echo is not None
            there.send(can.Message(arbitration_id=echo.arbitration_id + 0x100, data=echo.data, is_extended_id=False))
            answer = here.recv(5.0)
            assert answer is not None
            assert (answer.arbitration_id, bytes(answer.data)) == (0x200 + number, bytes([number, 1, 2]))
            trips.append(time.perf_counter() - start)
    return float(np.median(trips))


def main() -> None:
    """Run all; prints one line."""
    raw_sockets()
    start = time.perf_counter()
    compiled_function()
    first_call_s = time.perf_counter() - start
    print(f"smoke test: AF_CAN works, numba's first call {first_call_s:.2f} s, ", end="", flush=True)
    print(f"python-can round trip {python_can() * 1e3:.2f} ms", flush=True)


if __name__ == "__main__":
    main()
