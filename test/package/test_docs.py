"""The documentation: links exist, commands parse, Python runs, node pages agree with the schema."""

from __future__ import annotations

import json
import re
import runpy
import shlex
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import click
import pytest
import yaml

from dqwalk_ros.cli import dqwalk
from dqwalk_ros.config import Config, load, with_files
from dqwalk_ros.nodes.command_line import docstring, parameters_of, parse, sections_of
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.node_table import NODES
from dqwalk_ros.support.topics import BODY_TOPICS, PHASE_LOG, TOPICS
from dqwalk_ros.walks.course import speeds
from dqwalk_ros.walks.table import walk_type

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ROOT / "docs/nodes"  # by `make docs`
PAGES = sorted(p for p in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")] if GENERATED not in p.parents)
OURS = [ROOT / "docs/tutorial.md", ROOT / "docs/see.md"]


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.S | re.M)


@pytest.mark.parametrize("page", [p for p in PAGES if p.exists()], ids=lambda p: str(p.relative_to(ROOT)))
def test_link_targets_exist(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"https?:|mailto:|#", target):
            file = page.parent / target.partition("#")[0]
            assert file.exists(), f"{page.name} links to {target}"
            assert file.resolve().parent != ROOT / "docs/nodes", f"{page.name} links to {target}, a page of the website"


@pytest.mark.parametrize("page", [p for p in PAGES if p.exists()], ids=lambda p: str(p.relative_to(ROOT)))
def test_named_modules_exist(page):
    """Those named with their folder, as in ``walks/dynamic/plan.py``."""
    for name in re.findall(r"`((?:\w+/)+\w+\.py)\b", page.read_text()):
        folders = (ROOT, ROOT / "dqwalk_ros", ROOT / "dqwalk_ros/paper", ROOT / "test")
        assert any((folder / name).is_file() for folder in folders), name


def lines(page):
    """Return the words of each line of a page's blocks that is typed in a shell."""
    text = "\n".join(block for language in ("", "bash", "text") for block in blocks(page, language))
    found = []
    for begin in re.finditer(r"^ *(?:\$ )?(?=(?:dqwalk|ros2|make) )", text, re.M):
        line, *more = text[begin.end() :].split("\n")
        while line.count("'") % 2 or line.endswith("\\"):
            line = f"{line.removesuffix(chr(92))} {more.pop(0)}"
        words = shlex.split(line, comments=True)
        found.append(words[: words.index(">")] if ">" in words else words)
    return found


def check_dqwalk(name, *words):
    with click.Context(dqwalk) as context:
        dqwalk.get_command(context, name).make_context(name, list(words))  # raises if a word is unknown


def check_make(*words):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    assert words[0] in targets


def check_run(package, name, *words):
    assert package == "dqwalk_ros"
    check_dqwalk(*words) if name == "dqwalk" else parse(name, words)
    for file in (word for word in words if word.startswith("config/")):
        assert (ROOT / file).is_file(), file


def check_launch(package, file, *words):
    if package == "dqwalk_ros":
        text = (ROOT / "launch" / file).read_text()
        for name in (word.partition(":=")[0] for word in words):
            assert re.search(rf'^ +"{name}": \(', text, re.M), f"{file} has no argument {name}"


def check_service(package, name, kind, *_):
    assert package == "call"
    node, service = name.strip("/").split("/")
    assert re.search(rf"~/{service}\b.*{kind.split('/')[-1]}", docstring(node)), name


def check_topic(verb, *words):
    assert verb == "pub"
    topic, kind, message = words[-3:]
    rows = re.findall(r"^\| (`\S.*?) \| (.*?) \|", (ROOT / "docs/interfaces.md").read_text(), re.M)
    assert any(f"`{topic.strip('/')}`" in name and kind.replace("/msg/", "/") in types for name, types in rows), topic
    assert isinstance(yaml.safe_load(message), dict)


def check_param(verb, node, name, value):
    assert (verb, node) == ("set", "/controller")
    (spec,) = (spec for spec in parameters_of("controller") if spec.name == name)
    assert spec.live
    Config().updated({name: yaml.safe_load(value)})


ROS2 = {"run": check_run, "launch": check_launch, "service": check_service, "topic": check_topic, "param": check_param}


@pytest.mark.parametrize("page", [p for p in PAGES if lines(p)], ids=lambda p: str(p.relative_to(ROOT)))
def test_documented_lines_are_valid(page, monkeypatch):
    """Commands, options, nodes, launch files and their arguments, services, topics and types exist."""
    monkeypatch.chdir(ROOT)
    for program, *words in lines(page):
        if program == "ros2" and (check := ROS2.get(words[0])):
            check(*words[1:])
        elif program != "ros2":
            {"dqwalk": check_dqwalk, "make": check_make}[program](*words)


@pytest.mark.parametrize("page", OURS, ids=lambda p: p.name)
def test_documented_python_runs(page):
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("node", sorted(NODES))
def test_node_pages_match_the_schema(node):
    made = runpy.run_path(str(ROOT / "docs/make_nodes.py"))["page"](node)
    rows = dict(re.findall(r"^\| `([\w.]+)` \| ([^|]+) \|", made, re.M))
    assert list(rows) == [spec.name for spec in parameters_of(node)]
    assert rows
    for spec in parameters_of(node):
        if spec.type is float:
            assert float(rows[spec.name].split()[0]) == spec.default
    assert all(line.replace("::", ":") in made for line in docstring(node).splitlines())


@pytest.mark.parametrize("node", sorted(NODES))
def test_every_section_that_a_node_lists_has_parameters(node):
    """A name with an addition, such as 'standing (posture)', would list no parameter."""
    names = [spec.name for spec in parameters_of(node)]
    assert sections_of(node)
    for word in sections_of(node):
        assert any(name == word or name.startswith(f"{word}.") for name in names), word


@pytest.mark.parametrize(
    ("name", "folder"), [("equations", "dqwalk_ros/paper"), ("whole_body", "dqwalk_ros/whole_body")]
)
def test_named_places_of_equations_exist(name, folder):
    count = 0
    for row in re.findall(r"^\|.*\|$", (ROOT / f"docs/{name}.md").read_text(), re.M):
        places = re.findall(r"`(\w+\.py)`(?:: |, )((?:`\w+`(?:, )?)+)", row)
        places += re.findall(r"`(\w+\.py): (\w+(?:\.\w+)?)`", row)
        for file, names in places:
            text = (ROOT / folder / file).read_text()
            for found in re.findall(r"\w+", names):
                assert re.search(rf"^ *(def|class) {found}\b", text, re.M), f"{file} has no {found}"
                count += 1
    assert count >= 1


def test_topics_in_layouts_exist():
    known = {f"/{name}" for name in TOPICS} | {"/com", "/support_polygon", "/walk_markers"}
    layout = json.loads((ROOT / "config/foxglove.json").read_text())
    named = set(layout["configById"]["3D!walk"]["topics"])
    named |= {re.match(r"/\w+", found).group() for found in re.findall(r'"value": "(/[^"]+)"', json.dumps(layout))}
    assert named <= known
    curves = [c.get("name") for c in ElementTree.parse(ROOT / "config/plotjuggler.xml").iter("curve")]
    assert {re.match(r"/\w+", name).group() for name in curves} <= known
    rviz = yaml.safe_load((ROOT / "config/walk.rviz").read_text())["Visualization Manager"]["Displays"]
    topics = {d[key]["Value"] for d in rviz for key in ("Topic", "Description Topic") if key in d}
    assert {f"/{name}" for name in topics} <= known


@pytest.mark.parametrize(
    ("heading", "topics"), [("Topics", {**TOPICS, "phase_log": PHASE_LOG}), ("The whole-body walk", BODY_TOPICS)]
)
def test_the_documented_topics_are_those_of_the_nodes(heading, topics):
    section = (ROOT / "docs/interfaces.md").read_text().partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    rows = {}
    for names, *row in re.findall(r"^\| (`.*?`) \| (.*?) \| (.*?) \| (\w+) \| .*\|$", section, re.M):
        rows |= dict.fromkeys(re.findall(r"`(/?\w+)`", names), row)
    policy = {one.text for one in ElementTree.parse(ROOT / "config/security/policy.xml").iter("topic")}
    assert set(rows) <= policy | {"/clock"}  # which a test compares with the nodes
    publishers = {"effort": "controller", "physics": "`physics`", "warning": "any node"}
    for name, topic in topics.items():
        types, by, quality = rows[topic.name]
        package, _, kind = topic.type.split("/")
        assert package in types, name
        assert re.search(rf"\b{kind}\b", types), name
        assert quality == ("latched" if topic.latched else "reliable"), name
        if topics is not BODY_TOPICS or name not in TOPICS:
            assert publishers.get(topic.source, topic.source) in by, name


def test_the_first_page_of_the_website_links_to_every_node():
    add = runpy.run_path(str(ROOT / "docs/make_nodes.py"))["on_page_markdown"]
    index, other = (SimpleNamespace(file=SimpleNamespace(src_uri=name)) for name in ("index.md", "see.md"))
    assert re.findall(r"\]\(nodes/(\w+)\.md\)", add("# Title\n", index)) == list(NODES)
    assert add("# Title\n", other) == "# Title\n"


def test_the_website_folds_the_names_of_the_tests_of_faults():
    add = runpy.run_path(str(ROOT / "docs/make_nodes.py"))["on_page_markdown"]
    faults = SimpleNamespace(file=SimpleNamespace(src_uri="faults.md"))
    text = (ROOT / "docs/faults.md").read_text()
    folded = add(text, faults)
    named = re.findall(r"`[\w/]*(?:\.py)?::\w+`", text)
    assert sum(int(count) for count in re.findall(r"<summary>(\d+) tests?</summary>", folded)) >= len(named) > 100
    assert re.sub(r"<summary>.*?</summary>|</?details>", "", folded) == text


def test_the_lines_that_replace_the_plant_start_nodes_of_one_period():
    """The driver refuses the period of a simulation."""
    text = (ROOT / "docs/interfaces.md").read_text().partition("## Another plant")[2].partition("\n## ")[0]
    lines = [line.split() for line in re.findall(r"^ros2 run dqwalk_ros .*$", text, re.M)]
    assert [words[3] for words in lines] == ["controller", "phase_monitor", "integrator", "poppy_driver"]
    files = [[ROOT / b for a, b in pairwise(words) if a == "--params-file"] for words in lines]
    controller, *others = [with_files(Config(), each) for each in files]
    assert all(config == controller for config in others)
    assert controller.dt >= 0.99 / controller.poppy.rate
    assert not controller.node.autostart
    for service in re.findall(r"^ros2 service call /(\w+/\w+)", text, re.M):
        node, name = service.split("/")
        assert f"~/{name}" in docstring(node)


def test_the_documented_speeds_are_those_of_the_walks():
    text = (ROOT / "docs/interfaces.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \| ([\d.]+) \|$", text, re.M)
    assert len(rows) == 3
    for name, ahead, turn in rows:
        config = load(name).updated({"gait.steps": 0})
        forward, _, about = speeds(walk_type(config)(config, load_model(config.robot)))
        for shown, true in ((ahead, forward), (turn, about)):
            assert 0.0 <= true - float(shown) < 1e-3
