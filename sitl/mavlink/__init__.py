"""The MAVLink side of the vehicle: links, streams, commands, conversion of units."""
