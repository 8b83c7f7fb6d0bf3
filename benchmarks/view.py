# SPDX-License-Identifier: Apache-2.0
"""Live page: time to the first picture, CPU time against the number of bodies, and a contact sheet of robots.

    python benchmarks/view.py [start] [bodies] [node] [sheet FILE [PATH ...]]

start  : from the command to the page at its address, and to the first moving picture in a browser, median of 5
bodies : share of a core of the page's process, and frames per second, for 10 to 120 bodies with meshes
node   : p99 latency and CPU of a node at 1 kHz, with and without a page
sheet  : pictures of all example scenes and of robot files, in one image
Needs viser, playwright and Chromium.
"""

import os
import statistics
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import sync_playwright

from liegroup_core import Simulation, load_scene
from liegroup_core.errors import LieGroupSimError
from liegroup_core.scene.load import example_scenes, scene_from_robot, scene_from_text
from liegroup_sim_ros.view.export import picture_of
from liegroup_sim_ros.view.local import Local
from liegroup_sim_ros.view.page import Page

DRAWS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# Notes the times, ms since 1970, of frames with more than the ground.
WATCH = """
window.drawn = []; let count = 0;
for (const kind of ["drawElements", "drawArrays", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[kind];
  WebGL2RenderingContext.prototype[kind] = function(...a) { ++count; return draw.apply(this, a); };
}
const look = () => {
  if (count > 8) drawn.push(performance.timeOrigin + performance.now());
  count = 0; requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
TILE = (400, 300)
COLUMNS = 6


@contextmanager
def browser():
    """Chromium without a GPU."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=DRAWS)
        yield chromium
        chromium.close()


def start():
    """Medians of the time to the address and to the first moving picture."""
    command = [sys.executable, "-m", "liegroup_sim_ros.commands.main", "view", "four_bar", "--no-browser"]
    found = []
    with browser() as chromium:
        for _ in range(5):
            began = time.time()
            process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            line = process.stderr.readline()
            while "http" not in line:
                line = process.stderr.readline()
            served = time.time() - began
            page = chromium.new_page(viewport={"width": 900, "height": 600})
            page.add_init_script(WATCH)
            page.goto(line[line.index("http") :].split()[0])
            page.wait_for_function("drawn.length > 1")
            found.append((served, page.evaluate("drawn[1]") * 1e-3 - began))
            page.close()
            process.terminate()
            process.wait()
    served, moving = (statistics.median(times) for times in zip(*found))
    print(f"four_bar: address after {served:.2f} s, first moving picture after {moving:.2f} s (no GPU)")


def chain(n):
    """Scene of n balls on hinges."""
    bodies = "".join(
        f"  - {{name: b{k}, shape: {{type: sphere, radius: 0.1, mass: 1}}, position: [{0.3 * k + 0.3:.1f}, 0, 0]}}\n"
        for k in range(n)
    )
    joints = "".join(
        f"  - {{name: j{k}, type: revolute, parent: {'world' if k == 0 else f'b{k - 1}'}, child: b{k}, "
        f"child_frame: {{axis: [0, 1, 0], position: [-0.3, 0, 0]}}}}\n"
        for k in range(n)
    )
    return scene_from_text(f"name: chain\ngravity: [0, 0, -9.81]\nbodies:\n{bodies}joints:\n{joints}")


def bodies():
    """Share of a core, less that of the simulation alone, and frames per second that reach a browser."""
    print("bodies  page, % of a core  simulation alone  drawn frames/s")
    for n in (10, 30, 60, 120):
        source = Local(Simulation(chain(n), "rkmk4", 2e-3), "chain")
        alone = _share(3.0)
        page = Page(source, port=8400)
        page.start()
        shown = []
        draw = page._drawing.show
        page._drawing.show = lambda *arguments: (shown.append(time.monotonic()), draw(*arguments))
        with browser() as chromium:
            opened = chromium.new_page(viewport={"width": 900, "height": 600})
            opened.goto(page.address)
            time.sleep(4.0)
            shown.clear()
            both = _share(6.0)
            rate = len(shown) / 6.0
        page.stop()
        source.close()
        print(f"{n:6d}  {100 * (both - alone):16.1f}  {100 * alone:16.1f}  {rate:14.1f}")


def _share(seconds):
    began = time.process_time()
    time.sleep(seconds)
    return (time.process_time() - began) / seconds


def node():
    """Latency of poses of a node at 1 kHz: from its stamp to a subscriber, relative to the smallest, and its CPU."""
    code = "import sys; from liegroup_sim_ros.node.entry import main; sys.exit(main())"
    environment = {**os.environ, "ROS_DOMAIN_ID": "88", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    arguments = ["--ros-args", "-p", "scene:=four_bar", "-p", "publish_rate:=1000.0", "-p", "step:=0.001"]
    os.environ.update({name: environment[name] for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")})

    for with_page in (False, True):
        process = subprocess.Popen([sys.executable, "-c", code, *arguments], env=environment, stderr=subprocess.DEVNULL)
        listener = subprocess.Popen([sys.executable, "-c", LISTEN], env=environment, stdout=subprocess.PIPE, text=True)
        viewer = None
        if with_page:
            viewer = subprocess.Popen([sys.executable, "-c", VIEW], env=environment)
        time.sleep(8.0)
        began = _ticks(process.pid)
        time.sleep(10.0)
        share = (_ticks(process.pid) - began) / os.sysconf("SC_CLK_TCK") / 10.0
        kind, figures = "with" if with_page else "without", listener.communicate()[0].strip()
        print(f"{kind} a page: node {100 * share:.1f} % of a core, {figures}")
        for each in filter(None, (viewer, process)):
            each.terminate()
            each.wait()


def _ticks(pid):
    return sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]))


VIEW = """
import time
from liegroup_sim_ros.view.page import Page
from liegroup_sim_ros.view.remote import Remote
page = Page(Remote("/sim_node"), port=8410); page.start(); time.sleep(60)
"""
LISTEN = """
import time, numpy as np, rclpy
from geometry_msgs.msg import PoseStamped
rclpy.init(); node = rclpy.create_node("listener"); found = []
def take(message):
    found.append(time.time_ns() - message.header.stamp.sec * 10**9 - message.header.stamp.nanosec)
node.create_subscription(PoseStamped, "/sim_node/crank/pose", take, 1000)
end = time.monotonic() + 16
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
late = (np.array(found[len(found) // 3:]) - min(found[len(found) // 3:])) * 1e-6
print(f"latency p50 {np.percentile(late, 50):.2f} ms, p99 {np.percentile(late, 99):.2f} ms of {len(late)} poses")
"""


def sheet(file, paths):
    """Pictures of the example scenes and of robots after half a second of motion."""
    from PIL import Image, ImageDraw

    tiles = []
    with browser() as chromium:
        for name in [*example_scenes(), *paths]:
            try:
                scene = load_scene(name) if name in example_scenes() else scene_from_robot(name)
                source = Local(Simulation(scene, quiet=True), scene.name, paused=True)
            except LieGroupSimError as error:
                print(f"{name}: {str(error)[:100]}")
                continue
            page = Page(source, port=8500)
            page.start()
            opened = chromium.new_page(viewport={"width": 800, "height": 600})
            opened.goto(page.address)
            while not page.clients():
                time.sleep(0.05)
            time.sleep(3.0)  # light and meshes arrive after the page
            tile = Image.fromarray(picture_of(page.clients()[0])).crop((160, 0, 1120, 720)).resize(TILE)
            ImageDraw.Draw(tile).text((8, 8), scene.name, fill="black")
            tiles.append(tile)
            opened.close()
            page.stop()
            source.close()
    rows = -(-len(tiles) // COLUMNS)
    whole = Image.new("RGB", (COLUMNS * TILE[0], rows * TILE[1]), "white")
    for k, tile in enumerate(tiles):
        whole.paste(tile, (k % COLUMNS * TILE[0], k // COLUMNS * TILE[1]))
    whole.save(file)
    print(f"{file}: {len(tiles)} pictures")


def main():
    """Run the parts that the command line names."""
    parts = sys.argv[1:] or ["start", "bodies", "node"]
    if parts[0] == "sheet":
        sheet(parts[1], parts[2:])
        return
    for part in parts:
        {"start": start, "bodies": bodies, "node": node}[part]()


if __name__ == "__main__":
    main()
