"""`doctor`: what is good, what may not work, and what does not."""

import json
import os
import socket
from unittest import mock

from lidarcodec.commands.doctor import command
from lidarcodec.commands.doctor.about import about
from tests.command_line import run, run_here


def states(found):
    return {check["name"]: check["state"] for check in found["checks"]}


def test_a_line_for_each_check_and_below_them_the_facts():
    result = run_here("doctor")
    lines = result.stdout.splitlines()
    assert result.returncode == 0, result.stdout
    assert [line.split()[1] for line in lines[:3] if "->" not in line] == ["packages", "extras", "receive"]
    assert "versions" in lines
    assert "ports" in lines
    assert "extras" not in lines  # the check has them
    assert "hypothesis" not in result.stdout  # a package of developers


def test_what_is_wrong_in_the_environment_is_reported_with_what_to_do_and_code_1():
    result = run("doctor", "--json", LIDARCODEC_PUBLISH_CODEC="mp3", LIDARCODEC_PUBLSH_SET="intensity=off")
    found = json.loads(result.stdout)
    assert result.returncode == 1
    assert (states(found)["settings"], states(found)["environment"]) == ("bad", "warning")
    assert "did you mean LIDARCODEC_PUBLISH_SET?" in found["checks"][-1]["remedy"]


def test_a_port_that_another_program_has_is_a_warning():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with mock.patch("lidarcodec.commands.doctor.about.DATA_PORT", taken.getsockname()[1]):
            found = command.examined(())
    (check,) = (one for one in found["checks"] if one["name"].startswith("UDP"))
    assert check["state"] == "warning"
    assert "in use" in check["found"]
    assert check["found"].endswith("(sensor)")
    assert "UDP" not in check["found"]  # the line begins with it


def test_a_small_buffer_and_a_clock_that_nobody_holds_are_warnings():
    with (
        mock.patch("lidarcodec.commands.doctor.command.receive_buffer", return_value=212_992),
        mock.patch("lidarcodec.commands.doctor.command.clock_is_held", return_value=False),
    ):
        checks = {one["name"]: one for one in command.examined(())["checks"]}
    assert "sysctl -w net.core.rmem_max=" in checks["receive buffer"]["remedy"]
    assert "time service" in checks["clock"]["remedy"]


def test_packages_that_another_program_changed_are_named_and_bad():
    with mock.patch("lidarcodec.commands.doctor.about.metadata.version", side_effect=lambda name: "1.1"):
        check, extras = command.examined(())["checks"][:2]
    assert (check["name"], check["state"]) == ("packages", "bad")
    assert (extras["name"], extras["state"]) == ("extras", "warning")  # somebody who uses the extra is told
    assert "fastapi 1.1" not in extras["found"]
    assert "imagecodecs 1.1 (needs >=2025.3.30)" in extras["found"]
    assert "numpy 1.1 (needs >=2.0)" in check["found"]
    assert "environment of its own" in check["remedy"]


def test_few_open_files_are_a_warning():
    with mock.patch("lidarcodec.commands.doctor.command.resource.getrlimit", return_value=(256, 1024)):
        checks = {one["name"]: one for one in command.examined(())["checks"]}
    assert (checks["open files"]["state"], "LimitNOFILE=" in checks["open files"]["remedy"]) == ("warning", True)


def test_the_facts_hold_only_texts():
    clean = {key: value for key, value in os.environ.items() if not key.startswith("LIDARCODEC_")}
    with mock.patch.dict(os.environ, clean, clear=True):
        assert all(isinstance(value, str) for part in about().values() for value in part.values())
