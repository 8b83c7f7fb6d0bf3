# SPDX-License-Identifier: Apache-2.0
"""Recordings as the node writes them, made without its threads, with optional planted errors."""

from example_run import diagnostics_message, log_message
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_sim_ros.messages import inputs
from liegroup_sim_ros.messages.codecs import PoseStampedCodec, TwistStampedCodec
from liegroup_sim_ros.recording import attachments
from liegroup_sim_ros.recording.write import Recorder

PACING = {
    "ticks": 100,
    "overruns": 2,
    "reanchored": 0,
    "real_time_factor": 1.0,
    "lateness_us": {"p50": 0.1, "p99": 40.0, "max": 900.0},
    "wall_seconds": 1.0,
    "sim_seconds": 1.0,
}
PAIR = text_of("pair.yaml")


def record(
    path,
    scene,
    steps,
    step=2e-3,
    per_sample=10,
    group="se3",
    pushes=(),
    resets=(),
    spoil=lambda topic, k, data: data,
    pacing=PACING,
    end=True,
    promise=None,
    factors=None,
):
    """Record a run of a given number of steps.

    pushes : {step: (body, wrench)}, resets : steps at which to go back to the start
    promise : of an accuracy, as in Simulation, which the run need not keep
    factors : {step: requested real-time factor}, with that of step 0
    spoil  : may change a message, or drop it by returning None; k counts those of a topic
    """
    simulation = Simulation(scene, "rkmk4", step, group, estimate=False)
    bodies = [body.name for body in scene.bodies]
    topics = {
        "pose": {b: f"/sim_node/{b}/pose" for b in bodies},
        "twist": {b: f"/sim_node/{b}/twist" for b in bodies},
        "inputs": "/sim_node/inputs",
        "events": "/sim_node/events",
        "clock": None,
        "diagnostics": "/diagnostics",
    }
    count = {}
    more = {"promise": promise}
    if factors:
        more["parameters"] = {"real_time_factor": factors[0]}
    with Recorder(path, attachments.at_start(simulation, "/sim_node", "world", per_sample, topics, **more)) as recorder:
        channel = {
            t: recorder.add_channel(t, c.TYPE)
            for kind, c in (("pose", PoseStampedCodec), ("twist", TwistStampedCodec))
            for t in topics[kind].values()
        }
        channel[topics["inputs"]] = recorder.add_channel(topics["inputs"], inputs.TYPE)
        channel["/sim_node/events"] = recorder.add_channel(
            "/sim_node/events", "rcl_interfaces/msg/Log", "transient_local"
        )
        channel["/diagnostics"] = recorder.add_channel("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")

        def write(topic, stamp_ns, data):
            count[topic] = count.get(topic, -1) + 1
            data = spoil(topic, count[topic], data)
            if data is not None:
                recorder.write(channel[topic], stamp_ns, data)

        def put_out():
            sample = simulation.sample()
            stamp = base + sample.time_ns
            for b in bodies:
                write(
                    topics["pose"][b],
                    stamp,
                    PoseStampedCodec("world").encode(
                        stamp, sample.positions[b].tolist(), sample.quaternions[b].tolist()
                    ),
                )
                write(topics["twist"][b], stamp, TwistStampedCodec(b).encode(stamp, sample.twists[b].tolist()))

        base = 0
        write("/sim_node/events", 0, log_message(0, "start", "<b>begin</b>"))
        put_out()
        for k in range(1, steps + 1):
            if k - 1 in dict(pushes):
                simulation.apply_wrench(*dict(pushes)[k - 1])
            given = simulation.drain_applied()
            if given:
                write(topics["inputs"], base + simulation.time_ns, inputs.encode(base, given))
            simulation.advance()
            if simulation.steps % per_sample == 0:
                put_out()
            if k in (factors or {}):
                stamp = base + simulation.time_ns
                text = f"real-time factor {factors[k]:g}"
                write("/sim_node/events", stamp, log_message(stamp, "speed", text))
            if k in resets:
                base += simulation.time_ns + round(step * 1e9)
                simulation.reset()
                write("/sim_node/events", base, log_message(base, "reset", "initial state"))
                put_out()
        stamp = base + simulation.time_ns
        write(
            "/diagnostics",
            stamp,
            diagnostics_message(
                stamp,
                {
                    "real_time_factor_wanted": "1",
                    "lateness_p50_us": "0.1",
                    "lateness_p99_us": "40",
                    "lateness_max_us": "900",
                },
            ),
        )
        if end:
            write("/sim_node/events", stamp, log_message(stamp, "stop", "done"))
            recorder.add_attachment("pacing.json", *attachments.as_json(pacing))
    assert recorder.failure is None
    return path
