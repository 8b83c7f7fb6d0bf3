# SPDX-License-Identifier: Apache-2.0
"""How long a step of a simulation takes."""
import time


def seconds_of_step(simulation, steps, repeat):
    """CPU seconds of one step: the fastest of so many runs of so many steps from the start."""
    times = []
    for _ in range(repeat):
        simulation.reset()
        start = time.process_time()
        simulation.advance(steps)
        times.append(time.process_time() - start)
    return min(times) / steps
