"""`--json` of every command: there is one, its schema is written down, and what is printed fits the schema."""

import json
from typing import NotRequired, get_origin, get_type_hints

import pytest
from pydantic import TypeAdapter
from typing_extensions import is_typeddict

from lidarcodec.commands.running.telling import schema_of
from tests.command_line import commands, run_here
from tools.command_tables import members

OPEN = {"SourceInfo", "RecordingInfo", "MessageInfo", "Received", "Benched", "MapCompressed", "Published"}
"""Objects that may have more fields than those written down. Their text says so."""


def test_every_command_prints_json():
    without = [
        name for name, command in commands().items() if "--json" not in {o for one in command.params for o in one.opts}
    ]
    assert not without, f"add `as_json: AsJson = False` to {without}, and print with `tell`"


def test_every_command_has_a_schema_whose_fields_have_a_text():
    without = [name for name, command in commands().items() if schema_of(command.callback) is None]
    assert not without, f"write a TypedDict in commands/results and add `@prints(TYPE)` to {without}"
    for command in commands().values():
        for kind in members(schema_of(command.callback)):
            assert is_typeddict(kind)
            assert kind.__doc__, kind
            assert all(hint.count("Annotated[") == 1 for hint in map(str, kind.__annotations__.values())), kind


def printed(name, *words):
    """What a command prints with --json, after a check against its schema."""
    result = run_here(*name.split(), *words, "--json")
    found = json.loads(result.stdout)
    check(name, found)
    assert result.returncode == 0, result.stderr
    return found


def check(name, found):
    """Raises if a value does not fit the schema of a command, or has a field that is not written down."""
    schema = schema_of(commands()[name].callback)
    TypeAdapter(schema).validate_python(found)
    kinds = members(schema)
    for one in found if isinstance(found, list) else [found]:
        kind = next(kind for kind in kinds if required(kind) <= one.keys())
        more = one.keys() - kind.__annotations__.keys()
        assert kind.__name__ in OPEN or not more, f"{name} prints {sorted(more)}, which is not written down"


def required(kind):
    """Fields that an object of this type always has."""
    hints = get_type_hints(kind, include_extras=True)
    return {name for name, hint in hints.items() if get_origin(hint) is not NotRequired}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A capture of two turns, and its recording."""
    folder = tmp_path_factory.mktemp("drive")
    capture, recording = folder / "drive.pcap", folder / "drive.mcap"
    assert run_here("simulate", "sim:city", capture, "--frames", 2).returncode == 0
    assert run_here("encode", capture, recording).returncode == 0
    return capture, recording


def test_commands_that_write_name_their_outputs(tmp_path, drive):
    capture, recording = drive
    made = printed("simulate", "sim:city", tmp_path / "a.pcap", "--frames", 1)
    assert made["output"] == str(tmp_path / "a.pcap")
    assert made["beside"] == [str(tmp_path / "a_db.xml")]
    coded = printed("encode", capture, tmp_path / "a.mcap", "--frames", 1)
    assert (coded["frames"], coded["form"]) == (1, "recording")
    assert coded["ratio"] == pytest.approx(coded["packet_bytes"] / coded["coded_bytes"])
    decoded = printed("decode", recording, tmp_path / "a.ply", "--frames", 1)
    assert (decoded["form"], decoded["frames"]) == ("ply", 1)
    assert decoded["points"] > 100_000
    folder = printed("decode", recording, tmp_path / "scans")
    assert (folder["form"], folder["files"], folder["bytes"]) == ("kitti", 3, None)
    bag = printed("convert", capture, tmp_path / "bag")
    assert (bag["form"], bag["files"]) == ("rosbag", 3)


def test_commands_that_look_say_what_they_found(drive):
    capture, recording = drive
    verified = printed("verify", recording, capture)
    assert verified["packets_identical"] is True
    assert printed("info", capture)["packets"] == verified["packets"]
    assert printed("info", recording)["messages"] == 2
    assert printed("info", recording, "--message", 0)["message"] == 0
    assert printed("info").keys() == printed("doctor").keys()
    assert len(printed("bench", capture, "--codec", "raw,zstd", "--frames", 1)) == 2


def test_tokens_and_certificates(tmp_path):
    database = ("--database-url", f"sqlite:///{tmp_path}/fleet.db")
    made = printed("token create", "ada", *database)
    assert made["token"].startswith("lct_")
    assert [one["name"] for one in printed("token list", *database)] == ["ada"]
    assert printed("token revoke", "ada", *database) == {"name": "ada"}
    written = printed("certs", tmp_path / "fleet", "--router", "router.example", "--auth", "none")["written"]
    assert str(tmp_path / "fleet" / "router-router.example.json5") in written


def test_what_is_not_well_is_json_too_and_code_1():
    result = run_here("health", "--url", "http://127.0.0.1:1", "--json")
    found = json.loads(result.stdout)
    check("health", found)
    assert (result.returncode, found["well"]) == (1, False)
    assert "does not answer" in found["wrong"][0]
