# SPDX-License-Identifier: Apache-2.0
"""Decode every message of a recording with an independent reader; prints JSON counts by topic.

decode.py mcap_ros2|rosbags|pybag|small_mcap FILE
"""

import json
import sys
from collections import Counter
from pathlib import Path

counts = Counter()
if sys.argv[1] == "mcap_ros2":
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(sys.argv[2], "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        counts.update({channel.topic: 0 for channel in reader.get_summary().channels.values()})
        for _, channel, _, message in reader.iter_decoded_messages():
            assert message is not None
            counts[channel.topic] += 1
elif sys.argv[1] == "pybag":
    from pybag.mcap_reader import McapFileReader

    with McapFileReader.from_file(sys.argv[2], enable_crc_check=True) as reader:
        counts.update(dict.fromkeys(reader.get_topics(), 0))
        for message in reader.messages(reader.get_topics()):
            counts[message.topic] += 1
elif sys.argv[1] == "small_mcap":
    import small_mcap
    from mcap_ros2.decoder import DecoderFactory

    class Factory:
        """Decoders of mcap_ros2, which accept bytes but no memory views."""

        def decoder_for(self, encoding, schema):
            decode = DecoderFactory().decoder_for(encoding, schema)
            return lambda data: decode(bytes(data))

    with open(sys.argv[2], "rb") as stream:
        channels = small_mcap.get_summary(stream).channels.values()
        counts.update({channel.topic: 0 for channel in channels})
        stream.seek(0)
        for found in small_mcap.read_message_decoded(stream, decoder_factories=[Factory()]):
            assert found.decoded_message is not None
            counts[found.channel.topic] += 1
else:
    from rosbags.highlevel import AnyReader

    with AnyReader([Path(sys.argv[2])]) as reader:
        counts.update({connection.topic: 0 for connection in reader.connections})
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
print(json.dumps(counts))
