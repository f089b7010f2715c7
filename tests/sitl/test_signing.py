"""Signatures: who has the key is obeyed, and nobody else."""

import hashlib

import pytest
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from companion.kernel.errors import PlanError
from sitl.autopilot.interface import Ack
from sitl.mavlink.signing import Keyring, read_key

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
KEY = hashlib.sha256(b"a secret").digest()
NOW_UNIX_S = 1_700_000_000.0


def signing_codec(key=KEY, unix_s=NOW_UNIX_S):
    codec = development.MAVLink(None, 245, 190)
    codec.signing.secret_key = key
    codec.signing.sign_outgoing = True
    codec.signing.timestamp = round((unix_s - 1_420_070_400) * 1e5)
    return codec


def keyring():
    return Keyring(KEY, lambda: NOW_UNIX_S)


def test_a_signing_client_is_obeyed_and_gets_signed_answers(fly_mavlink):
    flight = fly_mavlink(keyring=keyring(), client={"codec": signing_codec()})
    flight.run(3.0)
    assert flight.acks(ARM, 1.0) == [Ack.ACCEPTED]
    messages = flight.run(1.0)
    assert messages  # its decoder takes only what is signed with the key
    assert all(message.get_signed() for message in messages)


def test_unsigned_commands_are_refused_but_telemetry_may_be_watched(fly_mavlink, caplog):
    flight = fly_mavlink(keyring=keyring())
    assert any(message.get_type() == "ATTITUDE" for message in flight.run(3.0))
    assert flight.acks(ARM, 1.0) == []
    assert not flight.autopilot.status.armed
    assert flight.value_of(b"MIS_TAKEOFF_ALT") == []
    (record,) = caplog.records
    assert record.message.startswith("refused COMMAND_LONG: this vehicle obeys signed messages")


@pytest.mark.parametrize(
    "codec",
    [signing_codec(key=bytes(32)), signing_codec(unix_s=NOW_UNIX_S - 90.0)],
    ids=["another key", "more than a minute old"],
)
def test_wrong_and_old_signatures_are_refused(fly_mavlink, codec):
    flight = fly_mavlink(keyring=keyring(), client={"codec": codec})
    flight.run(3.0)
    flight.client.command(ARM, 1.0)
    flight.server.poll()
    assert not flight.autopilot.status.armed


def test_a_recorded_command_cannot_be_replayed(fly_mavlink):
    flight = fly_mavlink(keyring=keyring(), client={"codec": signing_codec()})
    flight.run(3.0)
    codec = signing_codec(unix_s=NOW_UNIX_S + 1.0)
    arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(codec)
    disarm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 0, 0, 0, 0, 0, 0, 0).pack(codec)
    for frame, armed in ((arm, True), (disarm, False), (arm, False)):
        flight.client.socket.send(frame)
        flight.server.poll()
        assert flight.autopilot.status.armed is armed


@pytest.mark.parametrize(("content", "works"), [(KEY, True), (KEY.hex().encode(), True), (b"x", 0)])
def test_keys_are_read_from_a_file(tmp_path, content, works):
    path = tmp_path / "key"
    path.write_bytes(content)
    if works:
        assert read_key(path) == KEY
    else:
        with pytest.raises(PlanError, match="a signing key is 32 bytes, or as many in hexadecimal"):
            read_key(path)
    with pytest.raises(PlanError, match="cannot be read: No such file"):
        read_key(tmp_path / "nowhere")
