"""All that a scenario does in the node: its damage and the frames that leave it, with those of strangers among them."""

from collections.abc import Sequence

from servohil.hil.config import Rig
from servohil.sim_bench.actuator_node import ActuatorNode
from servohil.sim_bench.faults.bus_faults import Strangers
from servohil.sim_bench.faults.frame_faults import FrameFaults, Wire
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.node_damage import NodeDamage


class NodeFaults:
    """Faults of one node, in lockstep and in its own process; puts its damage into the node."""

    def __init__(self, node: ActuatorNode, rig: Rig, scenario: Sequence[Fault]) -> None:
        self._damage = NodeDamage(node, rig, scenario)
        self._frames = FrameFaults(rig, scenario, to_node=False)
        self._strangers = Strangers(rig, scenario)
        self._fd = node.codec.fd_flags
        self._cycle = -1
        node.damage = self._damage

    def begin(self, cycle: int) -> None:
        """The coming step is this cycle from the first ACTIVE one on; negative before."""
        self._cycle = cycle
        self._damage.begin(cycle)

    def frames(self, sent: Sequence[tuple[int, bytes]]) -> list[Wire]:
        """What is on the bus of what the node sent; strangers first, whose identifiers win."""
        wires = [Wire.of(can_id, data, self._fd.get(can_id, 0)) for can_id, data in sent]
        wires = self._frames.pass_on(wires, self._cycle)
        return [*self._strangers.frames(self._cycle), *wires]
