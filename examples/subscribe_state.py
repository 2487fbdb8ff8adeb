"""Print the live state of a rig. Needs eclipse-zenoh and protobuf, but no servohil: the rig serves its own schema."""

import argparse
import json

import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

options = argparse.ArgumentParser(description=__doc__)
options.add_argument("--connect", default="tcp/127.0.0.1:7447", help="where the controller's telemetry listens")
options.add_argument("--rig", default="bench")
options.add_argument("--count", type=int, default=0, help="stop after so many samples (0: never)")
arguments = options.parse_args()
hub = {"mode": "client", "connect": {"endpoints": [arguments.connect]}, "scouting": {"multicast": {"enabled": False}}}
with zenoh.open(zenoh.Config.from_json5(json.dumps(hub))) as session:
    reply = next(iter(session.get(f"servohil/v1/{arguments.rig}/schema/state")), None)
    if reply is None or reply.ok is None:
        raise SystemExit(f"no rig {arguments.rig!r} at {arguments.connect}")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(reply.ok.payload.to_bytes()).file:
        pool.Add(file)
    batch_class = message_factory.GetMessageClass(pool.FindMessageTypeByName("servohil.v1.StateBatch"))
    subscriber = session.declare_subscriber(f"servohil/v1/{arguments.rig}/state")
    seen = 0
    for message in subscriber:
        for s in batch_class.FromString(message.payload.to_bytes()).samples:
            print(f"{s.cycle:8d} {s.position_m:9.6f} m {s.est_velocity_mps:9.5f} m/s {s.command_v:7.3f} V", flush=True)
            seen += 1
            if seen == arguments.count:
                raise SystemExit
