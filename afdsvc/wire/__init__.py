"""The protobuf messages, the codec, and the one file with every zenoh key."""
