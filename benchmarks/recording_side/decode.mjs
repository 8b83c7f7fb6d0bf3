// SPDX-License-Identifier: Apache-2.0
// Decodes every message of a recording, found by its index; JSON of counts by topic.
import { open } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { decompress } from "fzstd";

const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(await open(process.argv[2], "r")),
  decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
});
const decoders = new Map();
const counts = {};
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
  decoders.set(channel.id, [channel.topic, new MessageReader(definition)]);
  counts[channel.topic] = 0;
}
for await (const message of reader.readMessages()) {
  const [topic, decoder] = decoders.get(message.channelId);
  decoder.readMessage(message.data);
  counts[topic] += 1;
}
console.log(JSON.stringify(counts));
