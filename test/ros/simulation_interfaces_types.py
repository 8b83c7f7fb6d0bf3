# SPDX-License-Identifier: Apache-2.0
"""Fields of the interfaces of simulation_interfaces that the node offers, and their type hashes.

The hashes (REP 2011) are those of the package's own .msg, .srv and .action files: equal hashes mean
equal fields, types and order. Constants and comments are not part of them.
"""

from interface_package import built

RESULT = "Result result\n"
NOTHING = f"---\n{RESULT}"
# Release 1.5.1, of ROS 2 Jazzy
JAZZY = {
    "msg/Result": "uint8 result\nstring error_message\n",
    "msg/SimulationState": "uint8 state\n",
    "msg/SimulatorFeatures": "uint16[] features\nstring[] spawn_formats\nstring custom_info\n",
    "msg/TagsFilter": "string[] tags\nuint8 filter_mode\n",
    "msg/Bounds": "uint8 type\ngeometry_msgs/Vector3[] points\n",
    "msg/EntityCategory": "uint8 category\n",
    "msg/EntityFilters": "string filter\nEntityCategory[] categories\nTagsFilter tags\nBounds bounds\n",
    "msg/EntityState": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Twist twist\ngeometry_msgs/Accel acceleration\n",
    "msg/Resource": "string uri\nstring resource_string\n",
    "msg/WorldResource": "string name\nResource world_resource\nstring description\nstring[] tags\n",
    "srv/GetSimulatorFeatures": "---\nSimulatorFeatures features\n",
    "srv/ResetSimulation": f"uint8 scope\n{NOTHING}",
    "srv/StepSimulation": f"uint64 steps 1\n{NOTHING}",
    "srv/GetSimulationState": f"---\nSimulationState state\n{RESULT}",
    "srv/SetSimulationState": f"SimulationState state\n{NOTHING}",
    "srv/GetEntities": f"EntityFilters filters\n{NOTHING}string[] entities\n",
    "srv/GetEntitiesStates": f"EntityFilters filters\n{NOTHING}string[] entities\nEntityState[] states\n",
    "srv/GetEntityState": f"string entity\n{NOTHING}EntityState state\n",
    "srv/SetEntityState": f"string entity\nEntityState state\n{NOTHING}",
    "srv/LoadWorld": "string uri\nstring resource_string\nbool fail_on_unsupported_element\n"
    f"bool ignore_missing_or_unsupported_assets\n{NOTHING}WorldResource world\n",
    "srv/GetCurrentWorld": f"{NOTHING}WorldResource world\n",
    "srv/GetAvailableWorlds": "string[] additional_sources\nTagsFilter filter\n"
    f"bool offline_only\nbool continue_on_error\n{NOTHING}WorldResource[] worlds\n",
    "action/SimulateSteps": f"uint64 steps\n{NOTHING}---\nuint64 completed_steps\nuint64 remaining_steps\n",
}
JAZZY_HASHES = {
    "msg/Result": "cf43a306adff3337a0a47143d8f5689933bc70a30478f13b077dc1fe3bc5ad17",
    "msg/SimulationState": "bb9f87ccdd98fba113052a512d9801e84ce732d0a2b3c2b0cb281828de36e415",
    "msg/SimulatorFeatures": "8b101c8529bc0ea3dcf056078254768f39832b9ef0adaf93bd5cea96c0de3305",
    "msg/TagsFilter": "5c3efc51e8ed04c266c09cb4691ec95b964cd410558e01d8c83646b038826b45",
    "msg/Bounds": "e8624fe51f0f5548197542697d924c5699ac7198f1e4c68e50c3ca2af73f5b3f",
    "msg/EntityCategory": "43bdf7933fddf75f6970f7a8fe7078524355d821d390b3954bb46ac36c03dfe1",
    "msg/EntityFilters": "8e7b12e8ea062f14c55de4877221fe1b7cd9749665a7ad8a4ab855fc4b148303",
    "msg/EntityState": "2e0464a85eb80a939025075d6c20761eca6a4cb9d6baf2c0ba373467c8b598d0",
    "msg/Resource": "2bb1939cf80f8d2f284afba53cbec60b5ff33759bd39b714128ea8867a34c51a",
    "msg/WorldResource": "e3b65ecf904b9b115673e4a343c6aa3d28c19e185a71228faa64b783afcf2403",
    "srv/GetSimulatorFeatures": "abb9439c8cf196722a469fb6c68b44b484f198c2a1356ac38849a29c2a20a794",
    "srv/ResetSimulation": "4ce285d7ff9b8ac70dcc95161f32bf54c05a6f4b13427990e41ab40c36c39646",
    "srv/StepSimulation": "913fe0653690ce6bf8f09f316e6a626747012e9fca31e26719910d417aa8565c",
    "srv/GetSimulationState": "3362dcebee4b1afebbf9c4beee5c79c1455385aded62092a892d61fde8644f30",
    "srv/SetSimulationState": "a868b916dce49974f637ba252141258c4b07b0c06858b88af560e3eb6bfbcb30",
    "srv/GetEntities": "cb90004c48cd50f37732fb008e22c34c261dd680a723bf0f85d8437ea4498bf7",
    "srv/GetEntitiesStates": "0a76170d0c1c90e1eaf805cfab78ea801d1f82df309a28c1f0fae4b570f19754",
    "srv/GetEntityState": "749c91f2a2353d98367b64f2995a0f5842ce92a08ec1ffb3e185540a91557fb5",
    "srv/SetEntityState": "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
    "srv/LoadWorld": "f210682338f195f6f06191b46b20ec4992bddf485d33e2cffab2dd15341b4e3e",
    "srv/GetCurrentWorld": "79ed4e910e1b7a1c9f7950ff758bfba3535bf0dec669054e8af115a099724ddd",
    "srv/GetAvailableWorlds": "ce5589b5523f2732d1969a3c5a7e6b17a387091df8190c62f78d7fdd1109e3e3",
    "action/SimulateSteps": "f0837c898e1219cd73bf4c041feab41e8c533e8e1057e982744dba7b093467eb",
}
# Release 2.1.0 differs in two of them.
LATEST = JAZZY | {
    "srv/SetEntityState": "string entity\nEntityState state\nbool set_pose\nbool set_twist\n"
    f"bool set_acceleration\n{NOTHING}",
    "srv/LoadWorld": "Resource world_resource\nbool fail_on_unsupported_element\n"
    f"bool ignore_missing_or_unsupported_assets\n{NOTHING}WorldResource world\n",
}
LATEST_HASHES = JAZZY_HASHES | {
    "srv/SetEntityState": "fba636c91d38832dbd4f6896ffce54ff98fd9929962b0533546b56ce00f988ac",
    "srv/LoadWorld": "87d0ded1bfddb40a74d0bedb963fdd592fbedb14d0057d597850404b73c338af",
}


def package(definitions, cache):
    """Folder in which Python finds the package, see interface_package.built."""
    return built("simulation_interfaces", definitions, cache)
