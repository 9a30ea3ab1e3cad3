"""The compose files: valid, closed by default, without a password, and of one piece with the programs they start."""

from __future__ import annotations

import json
import re
import subprocess
from importlib.resources import files

import pytest
import yaml
from sqlalchemy import make_url

from tests.images.compose import FOLDER, read, service_networks
from tests.images.dockerfile import ROOT
from tests.images.test_dockerfile import STAGES, check_words, last, variables

COMPOSE = read("compose.yaml")
SECURED = read("compose.yaml", "compose.secured.yaml")
SERVICES = COMPOSE["services"]
OURS = {name: one for name, one in SERVICES.items() if "build" in one}
each_service = pytest.mark.parametrize("name", SERVICES)


@pytest.mark.parametrize("compose", [COMPOSE, SECURED], ids=["compose", "secured"])
def test_it_is_what_the_compose_specification_allows(compose):
    jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema")
    pytest.importorskip("check_jsonschema", reason="needs check-jsonschema, which has the schema of the specification")
    schema = json.loads((files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json").read_text())
    jsonschema.validate(compose, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(compose | {"services": {"router": {"imagine": "nothing"}}}, schema)


@each_service
def test_a_service_can_do_little_and_comes_back_by_itself(name):
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert service["restart"] == "unless-stopped"
    assert {"cpus", "memory", "pids"} <= set(service["deploy"]["resources"]["limits"])
    assert service["logging"]["options"]["max-size"]
    assert "privileged" not in service
    if "build" in service:
        assert last(service["build"]["target"], "HEALTHCHECK")
    else:
        assert re.fullmatch(r"[1-9]\d*:\d+", service["user"])
        assert service["healthcheck"]["test"][0] == "CMD"
        assert re.search(r":v?\d+\.\d+(\.\d+)?", service["image"]), "one version"


@each_service
def test_what_a_service_names_is_there(name):
    service = SERVICES[name]
    assert service_networks(service) <= set(COMPOSE["networks"])
    assert set(service.get("secrets", [])) <= set(COMPOSE["secrets"])
    for volume in service.get("volumes", []):
        source, target, *_ = volume.split(":")
        assert target.startswith("/")
        assert source in COMPOSE["volumes"] or (FOLDER / source).exists(), source
    for other, how in service.get("depends_on", {}).items():
        if how["condition"] == "service_healthy":
            assert "healthcheck" in SERVICES[other] or "build" in SERVICES[other]


def test_everything_that_is_declared_is_used():
    used = [one for service in SERVICES.values() for one in service.get("secrets", [])]
    assert set(used) == set(COMPOSE["secrets"])
    assert {one for service in SERVICES.values() for one in service_networks(service)} == set(COMPOSE["networks"])
    mounted = " ".join(one for service in SERVICES.values() for one in service.get("volumes", []))
    assert all(re.search(rf"\b{name}:/", mounted) for name in COMPOSE["volumes"])


def test_there_is_no_password_in_any_file_and_git_takes_none():
    for service in [*SERVICES.values(), *SECURED["services"].values()]:
        for key, value in service.get("environment", {}).items():
            if re.search(r"PASSWORD|TOKEN|SECRET", key):
                assert str(value).startswith("/run/secrets/"), key
    assert make_url(SERVICES["server"]["environment"]["LIDARCODEC_DATABASE_URL"]).password is None
    for secret in SECURED["secrets"].values():
        path = f"docker/{secret['file'].removeprefix('./')}"
        assert subprocess.run(["git", "check-ignore", "-q", path], cwd=ROOT, check=False, timeout=60).returncode == 0


def test_only_this_machine_reaches_it_until_somebody_says_otherwise():
    for service in SERVICES.values():
        for port in service.get("ports", []):
            assert re.match(r"\$\{[A-Z]+_ADDRESS:-127\.0\.0\.1\}:\d+:\d+$", port)
    open_ones = {name for name, how in COMPOSE["networks"].items() if not how.get("internal")}
    assert {name for name, one in SERVICES.items() if service_networks(one) & open_ones} == {
        "router",
        "server",
        "grafana",
    }
    assert {name for name, one in SERVICES.items() if "database" in service_networks(one)} == {"server", "database"}


@pytest.mark.parametrize("name", OURS)
def test_our_programs_are_started_with_what_they_know(name):
    service = OURS[name]
    assert service["build"]["target"] in STAGES
    assert (FOLDER / service["build"]["context"] / service["build"]["dockerfile"]).exists()
    if "command" in service:
        check_words(service["command"])
    for compose in (COMPOSE, SECURED):
        told = {key for key in compose["services"][name]["environment"] if key.startswith("LIDARCODEC_")}
        assert told
        assert told <= variables()


def test_the_parts_find_each_other():
    server, database = SERVICES["server"]["environment"], SERVICES["database"]["environment"]
    url = make_url(server["LIDARCODEC_DATABASE_URL"])
    assert (url.host, url.username, url.database) == ("database", database["POSTGRES_USER"], database["POSTGRES_DB"])
    assert server["LIDARCODEC_SERVE_DATABASE_PASSWORD_FILE"] == database["POSTGRES_PASSWORD_FILE"]
    router = re.match(r"tcp/(\w+):(\d+)", server["LIDARCODEC_CONNECT"])
    assert router[1] in SERVICES
    assert f":{router[2]}" in (ROOT / "packaging" / "zenoh-router.json5").read_text()
    assert SERVICES["vehicle"]["environment"]["LIDARCODEC_CONNECT"] == server["LIDARCODEC_CONNECT"]
    asked = yaml.safe_load((FOLDER / "prometheus" / "prometheus.yaml").read_text())["scrape_configs"][0]
    port = last("server", "EXPOSE").value
    assert asked["static_configs"] == [{"targets": [f"server:{port}"]}]
    assert asked["authorization"]["credentials_file"] == f"/run/secrets/{SERVICES['prometheus']['secrets'][0]}"
    for one, other in (
        ("server", "database"),
        ("server", "router"),
        ("server", "prometheus"),
        ("grafana", "prometheus"),
    ):
        assert service_networks(SERVICES[one]) & service_networks(SERVICES[other])
    source = yaml.safe_load((FOLDER / "grafana/provisioning/datasources/prometheus.yaml").read_text())
    assert source["datasources"][0]["url"] == "http://prometheus:9090"


def test_a_secured_router_takes_its_file_and_nobody_connects_without():
    services = SECURED["services"]
    assert "volumes" not in services["router"]
    assert services["router"]["command"] == ["-c", "/run/secrets/router_zenoh"]
    assert "LIDARCODEC_CONNECT" not in services["server"]["environment"]
    assert services["server"]["environment"]["LIDARCODEC_ZENOH_CONFIG"] == "/run/secrets/server_zenoh"


def test_the_variables_of_the_example_are_those_that_are_read():
    shown = set(re.findall(r"^(?:# )?([A-Z_]+)=", (FOLDER / "env.example").read_text(), flags=re.MULTILINE))
    texts = [(FOLDER / name).read_text() for name in ("compose.yaml", "compose.secured.yaml")]
    assert shown == {name for text in texts for name in re.findall(r"\$\{([A-Z_]+)", text)}
    for name, value in re.findall(r"^([A-Z_]+)=(\S+)", (FOLDER / "env.example").read_text(), flags=re.MULTILINE):
        assert f"${{{name}:-{value}}}" in texts[0], "the example says what holds without it"
