"""The compose file, the scrape configuration and the Grafana dashboard, read as data: no container is started."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from apel.building.registry import SELECTORS

ROOT = Path(__file__).parent.parent
MONITORING = ROOT / "monitoring"
TEXT = (ROOT / "docker-compose.yml").read_text()
COMPOSE: dict[str, Any] = yaml.safe_load(TEXT)
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
NODES = ("head", "worker")
DASHBOARD: dict[str, Any] = json.loads((MONITORING / "grafana/dashboards/apel.json").read_text())
PANELS: list[dict[str, Any]] = DASHBOARD["panels"]
VARIABLES: list[dict[str, Any]] = DASHBOARD["templating"]["list"]

JOB = {"experiment", "apel_job"}
ARM = JOB | {"arm"}
# What the jobs export, with the labels of each.
OURS = {
    "ray_apel_episodes_total": ARM,
    "ray_apel_steps_total": ARM,
    "ray_apel_rounds_total": ARM,
    "ray_apel_round_seconds_total": ARM,
    "ray_apel_checkpoint_seconds_total": ARM,
    "ray_apel_restarts_total": JOB,
    "ray_apel_runs_planned": ARM,
    "ray_apel_runs_done": ARM,
    "ray_apel_runs_failed": ARM,
    "ray_apel_mean_return": ARM,
    "ray_apel_mean_train_time": ARM,
    "ray_apel_selection_share": ARM | {"learner"},
    "ray_apel_concentration": ARM | {"learner"},
}
# What Ray exports of its nodes; `instance` is Prometheus's own.
NODE = {"instance", "RayNodeType", "SessionName"}
RAYS = {"ray_node_cpu_utilization": NODE, "ray_node_mem_used": NODE, "ray_node_mem_total": NODE}
METRICS = OURS | RAYS
FUNCTIONS = {"sum", "avg", "rate", "label_values"}

every_service = pytest.mark.parametrize("service", SERVICES)


def flags(service: str) -> dict[str, str]:
    """The options of a service's command, as they are without a variable set."""
    pairs = (str(word).partition("=") for word in SERVICES[service]["command"] if str(word).startswith("--"))
    return {name: re.sub(r"\$\{\w+:-(.*?)\}", r"\1", value) for name, _, value in pairs}


def mounts(service: str) -> Iterator[list[str]]:
    """Source, target and mode of each volume."""
    return (volume.split(":") for volume in SERVICES[service]["volumes"])


def provisioned(name: str) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((MONITORING / "grafana/provisioning" / name).read_text())
    return content


def targets() -> list[dict[str, Any]]:
    return [target for panel in PANELS for target in panel.get("targets", [])]


def expressions() -> list[str]:
    return [target["expr"] for target in targets()] + [variable["query"]["query"] for variable in VARIABLES]


@every_service
def test_nothing_is_published_beyond_this_machine(service: str) -> None:
    """Each published port is bound to 127.0.0.1, and only the two pages are published."""
    ports = SERVICES[service].get("ports", [])
    assert all(re.fullmatch(r"127\.0\.0\.1:\d+:\d+", port) for port in ports)
    assert bool(ports) == (service in {"head", "grafana"})


@every_service
def test_services_are_confined(service: str) -> None:
    """A service gains no rights, is not root, and has limits of memory, processors and processes."""
    definition = SERVICES[service]
    assert definition["cap_drop"] == ["ALL"]
    assert definition["security_opt"] == ["no-new-privileges:true"]
    assert not {"privileged", "cap_add", "network_mode", "pid", "devices"} & set(definition)
    assert {"mem_limit", "cpus", "pids_limit"} <= set(definition)
    if service in NODES:  # Ray writes in its home, and Compose does not put secrets into a read-only container
        users = re.findall(r"^USER (\w+)", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
        assert users[-1] == "ray"
    else:
        assert definition["read_only"] is True
        assert not definition["user"].startswith(("0", "root"))


@every_service
def test_services_are_watched(service: str) -> None:
    """A service says whether it is well, and comes back when it ends."""
    assert SERVICES[service]["restart"] == "unless-stopped"
    assert SERVICES[service]["healthcheck"]["test"][0] == "CMD"


@every_service
def test_images_are_pinned(service: str) -> None:
    """An image has a whole version, so that tomorrow's start is today's."""
    assert re.fullmatch(r"[\w./-]+:v?\d+\.\d+\.\d+", SERVICES[service]["image"])


def test_base_image_is_the_pinned_ray() -> None:
    """The nodes run the version of Ray that the constraints name."""
    (pinned,) = re.findall(r"^ray(?:\[\w+\])?==([\d.]+)", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE)
    (base,) = re.findall(r"^FROM rayproject/ray:([\d.]+)-", (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
    assert base == pinned


def test_image_compiles_with_what_there_is() -> None:
    """The names that the image's build asks this project for exist; its selectors are those that are shipped."""
    (command,) = re.findall(r'^RUN python -c "(.*)"$', (ROOT / "Dockerfile").read_text(), flags=re.MULTILINE)
    calls: list[object] = []
    statements = [part.strip() for part in command.split(";")]
    names: dict[str, object] = {}
    exec("\n".join(statements[:-1]), names)  # the imports
    exec(statements[-1], {**names, "compile_for": calls.append})
    assert calls == [SELECTORS]


def test_extras_of_the_image() -> None:
    """They come from the environment, exist in pyproject.toml, and are none unless asked for."""
    build = SERVICES["head"]["build"]
    assert build["args"]["EXTRAS"] == "${APEL_EXTRAS:-}"
    dockerfile = (ROOT / "Dockerfile").read_text()
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    (named,) = re.findall(r"beside the service: (.*), or several", dockerfile)
    assert set(named.split(", ")) <= extras


def test_token_is_a_secret_without_default() -> None:
    """The token reaches the nodes as a file, from a variable that has no default, and stands in no environment."""
    assert COMPOSE["secrets"] == {"ray-token": {"environment": "APEL_RAY_TOKEN"}}
    assert "${APEL_RAY_TOKEN" not in TEXT
    assert not re.search(r"^\s+RAY_AUTH_TOKEN:", TEXT, flags=re.MULTILINE)
    for service, definition in SERVICES.items():
        secrets = [secret["source"] for secret in definition.get("secrets", [])]
        assert secrets == (["ray-token"] if service in NODES else [])
    for node in NODES:
        assert SERVICES[node]["environment"]["RAY_AUTH_MODE"] == "token"
        assert SERVICES[node]["environment"]["RAY_AUTH_TOKEN_PATH"] == "/run/secrets/ray-token"


def test_nobody_logs_in_to_grafana() -> None:
    """Visitors look only, there is no account with a password that everyone knows, and nothing is reported home."""
    settings = SERVICES["grafana"]["environment"]
    assert settings["GF_AUTH_ANONYMOUS_ORG_ROLE"] == "Viewer"
    assert settings["GF_SECURITY_DISABLE_INITIAL_ADMIN_CREATION"] == "true"
    assert settings["GF_AUTH_DISABLE_LOGIN_FORM"] == "true"
    assert settings["GF_AUTH_BASIC_ENABLED"] == "false"
    assert not any("PASSWORD" in name for name in settings)
    for name in ("REPORTING_ENABLED", "CHECK_FOR_UPDATES", "CHECK_FOR_PLUGIN_UPDATES"):
        assert settings[f"GF_ANALYTICS_{name}"] == "false"
    assert settings["GF_PLUGINS_PREINSTALL_DISABLED"] == "true"


@every_service
def test_what_is_mounted_exists(service: str) -> None:
    """A file or folder of the checkout that is mounted exists and is read-only; a volume is declared."""
    for source, _, *mode in mounts(service):
        if source.startswith("."):
            assert (ROOT / source).exists()
            assert mode == ["ro"]
        else:
            assert source in COMPOSE["volumes"]


def test_volumes_of_the_nodes_can_be_written() -> None:
    """Ray's user owns the folders that the nodes' volumes cover, and results go where the volume is."""
    (owned,) = re.findall(r"install -d -o ray -g users (.*)", (ROOT / "Dockerfile").read_text())
    for node in NODES:
        covered = {target for _, target in mounts(node)}
        assert covered <= set(owned.split())
        assert SERVICES[node]["environment"]["APEL_RESULTS"] in covered


def test_prometheus_scrapes_every_node() -> None:
    """The targets are the ports at which the nodes export, for the head and for any number of workers."""
    scraped = {
        (name, str(discovery["port"]))
        for job in _scrape_jobs()
        for discovery in job["dns_sd_configs"]
        for name in discovery["names"]
    }
    head = SERVICES["head"]["environment"]
    expected = {(node, flags(node)["--metrics-export-port"]) for node in NODES}
    expected |= {("head", head["AUTOSCALER_METRIC_PORT"]), ("head", head["DASHBOARD_METRIC_PORT"])}
    assert scraped == expected


def test_instance_is_the_bare_address() -> None:
    """Ray's dashboards filter `instance` and `NodeAddress`, which has no port, by one variable."""
    for job in _scrape_jobs():
        (rule,) = job["relabel_configs"]
        assert rule["target_label"] == "instance"
        found = re.fullmatch(rule["regex"], "172.18.0.4:8080")
        assert found is not None
        assert found[1] == "172.18.0.4"


def _scrape_jobs() -> list[dict[str, Any]]:
    jobs: list[dict[str, Any]] = yaml.safe_load((MONITORING / "prometheus.yml").read_text())["scrape_configs"]
    return jobs


def test_rays_dashboard_finds_prometheus_and_grafana() -> None:
    """What the head is told of Prometheus and Grafana is what they are."""
    environment = SERVICES["head"]["environment"]
    (source,) = provisioned("datasources/prometheus.yml")["datasources"]
    assert environment["RAY_PROMETHEUS_NAME"] == source["name"]
    assert environment["RAY_PROMETHEUS_HOST"] == source["url"]
    assert source["url"].endswith(flags("prometheus")["--web.listen-address"].partition(":")[2])
    (published,) = SERVICES["grafana"]["ports"]
    address, port, inside = published.split(":")
    assert environment["RAY_GRAFANA_HOST"] == f"http://grafana:{inside}"
    assert f":-http://{address}:{port}}}" in environment["RAY_GRAFANA_IFRAME_HOST"]
    assert SERVICES["grafana"]["environment"]["GF_SECURITY_ALLOW_EMBEDDING"] == "true"


def test_grafana_shows_rays_dashboards_and_ours() -> None:
    """Both folders that Grafana reads are mounted, and Ray writes into the one that is not ours."""
    at = {target: source for source, target, *_ in mounts("grafana")}
    paths = {provider["name"]: provider["options"]["path"] for provider in _providers()}
    written = SERVICES["head"]["environment"]["RAY_METRICS_GRAFANA_DASHBOARD_OUTPUT_DIR"]
    assert at[paths["Ray"]] == {target: source for source, target, *_ in mounts("head")}[written]
    assert (ROOT / at[paths["APEL"]] / "apel.json").is_file()
    home = SERVICES["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    assert home == f"{paths['APEL']}/apel.json"


def _providers() -> list[dict[str, Any]]:
    providers: list[dict[str, Any]] = provisioned("dashboards/dashboards.yml")["providers"]
    return providers


@pytest.mark.parametrize("expression", expressions())
def test_expressions_name_what_is_exported(expression: str) -> None:
    """A query has only metrics that are exported, with labels that they have, and variables of this dashboard."""
    selectors = re.findall(r"(ray_\w+)(?:\{(.*?)\})?", expression)
    assert selectors
    for metric, matchers in selectors:
        assert metric in METRICS
        assert set(re.findall(r"(\w+)=~?\"", matchers)) <= METRICS[metric]
    for grouping in re.findall(r"by \((.*?)\)", expression):
        assert set(grouping.split(", ")) <= METRICS[selectors[0][0]]
    for label in re.findall(r"label_values\(.*, (\w+)\)", expression):
        assert label in METRICS[selectors[0][0]]
    known = {variable["name"] for variable in VARIABLES} | {"__rate_interval"}
    assert set(re.findall(r"\$(\w+)", expression)) <= known
    assert set(re.findall(r"(\w+)\s*\(", re.sub(r"by \(.*?\)", "", expression))) <= FUNCTIONS


def test_counters_are_shown_as_rates() -> None:
    """A counter is shown by its rate, but for the restarts, which are few."""
    for expression in expressions():
        for counter in re.findall(r"(rate\()?(ray_apel_\w+_total)", expression):
            assert counter[0] or counter[1] == "ray_apel_restarts_total"


def test_every_metric_is_shown() -> None:
    """Nothing is exported for nobody."""
    shown = " ".join(target["expr"] for target in targets())
    assert [metric for metric in METRICS if not re.search(rf"\b{metric}\b", shown)] == []


def test_legends_use_labels_that_are_kept() -> None:
    """A legend names only labels by which its query groups."""
    for target in targets():
        grouping = set(re.findall(r"\w+", " ".join(re.findall(r"by \((.*?)\)", target["expr"]))))
        assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= grouping


def test_panels_explain_themselves() -> None:
    """A panel has a title, a description and a unit; ids are unique."""
    assert len({panel["id"] for panel in PANELS}) == len(PANELS)
    for panel in PANELS:
        assert panel["title"]
        if panel["type"] != "row":
            assert panel["description"]
            assert panel["fieldConfig"]["defaults"]["unit"]


def test_panels_do_not_overlap() -> None:
    """Every cell of the grid of 24 columns belongs to one panel at most."""
    cells: set[tuple[int, int]] = set()
    for panel in PANELS:
        at = panel["gridPos"]
        assert at["x"] + at["w"] <= 24
        covered = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert not covered & cells
        cells |= covered


def test_selection_is_repeated_for_each_arm() -> None:
    """The row with what the selector does stands once per arm, and a query in it has that arm alone."""
    (repeated,) = [number for number, panel in enumerate(PANELS) if "repeat" in panel]
    following = PANELS[repeated + 1 : repeated + 3]
    assert PANELS[repeated]["type"] == "row"
    assert PANELS[repeated]["repeat"] == "arm"
    assert "ray_apel_selection_share" in following[0]["targets"][0]["expr"]
    assert "ray_apel_concentration" in following[1]["targets"][0]["expr"]
    assert PANELS[repeated + 3]["type"] == "row"


def test_dashboard_uses_the_provisioned_source() -> None:
    """Panels, queries and variables ask the one data source there is."""
    (source,) = provisioned("datasources/prometheus.yml")["datasources"]
    expected = {"type": source["type"], "uid": source["uid"]}
    asking = [panel for panel in PANELS if panel["type"] != "row"] + targets() + VARIABLES
    assert all(item["datasource"] == expected for item in asking)


def test_the_step_of_the_rates_follows_the_scrapes() -> None:
    """Grafana derives the window of a rate from the scrape interval, so it must know the true one."""
    (source,) = provisioned("datasources/prometheus.yml")["datasources"]
    scraping = yaml.safe_load((MONITORING / "prometheus.yml").read_text())["global"]
    assert source["jsonData"]["timeInterval"] == scraping["scrape_interval"]
