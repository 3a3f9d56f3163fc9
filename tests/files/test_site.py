"""The site file: what is right is read, what is wrong is named by file, key, value found and value expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from afdsvc.errors import BadInput
from afdsvc.files.site import parse_site, read_site

GOOD = """
site = "lab"
[[machines]]
id = "bearing-1"
plant = "gas_bearing"
"""


def test_defaults_are_safe():
    site = parse_site(GOOD, "site.toml")
    assert site.transport.listen == ["tcp/127.0.0.1:7447"]
    assert site.transport.connect == []
    assert site.machines[0].bursts.every_seconds is None
    assert site.text == GOOD


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("site = \n", ["site.toml", "not a TOML file", "line 1"]),
        (GOOD + "block = 5\n", ["machines[0].block", "is 5", "a number of at least 10"]),
        (GOOD + "blok = 500\n", ["machines[0].blok", "is not known"]),
        (GOOD.replace('id = "bearing-1"\n', ""), ["machines[0].id", "missing"]),
        (GOOD.replace("bearing-1", "a/b"), ["machines[0].id", "'a/b'", "letters, digits"]),
        (GOOD + 'model = "m.toml"\n', ["exactly one of 'plant' and 'model'"]),
        (GOOD.replace('plant = "gas_bearing"\n', ""), ["exactly one of 'plant' and 'model'"]),
        (
            GOOD + '[[machines]]\nid = "bearing-1"\nplant = "gas_bearing"\n',
            ["ids must differ", "'bearing-1' appears 2 times"],
        ),
        (GOOD + 'driver = {kind = "replay"}\n', ["machines[0].driver", "needs 'recording'"]),
        (GOOD + 'driver = {faults = [{name = "x", severity = -3}]}\n', ["severity", "is -3", "-1"]),
        ('site = "lab"\nmachines = []\n', ["machines", "at least 1"]),
        ('site = "lab"\ntext = "x"\n', ["unknown"]),
        ("site = 3\n" + GOOD.replace('site = "lab"', ""), ["'site'", "is 3", "expected text"]),
    ],
)
def test_wrong_files_are_named(text, words):
    with pytest.raises(BadInput) as error:
        parse_site(text, "site.toml")
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_unreadable_files_are_named(tmp_path: Path):
    with pytest.raises(BadInput, match=r"missing\.toml"):
        read_site(tmp_path / "missing.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match=r"binary\.toml"):
        read_site(tmp_path / "binary.toml")


def test_paths_are_relative_to_the_file(tmp_path: Path):
    (tmp_path / "site.toml").write_text(
        'site = "lab"\n[[machines]]\nid = "axis"\nmodel = "model.toml"\ndriver = {kind = "replay", recording = "run.csv"}\n'
    )
    machine = read_site(tmp_path / "site.toml").machines[0]
    assert machine.model == tmp_path / "model.toml"
    assert machine.driver.recording == tmp_path / "run.csv"


def test_an_unknown_machine_lists_those_there_are():
    with pytest.raises(BadInput, match="no machine 'x'; it has bearing-1"):
        parse_site(GOOD, "site.toml").machine("x")


@pytest.mark.parametrize("name", ["service", "ca", "rig.bearing"])
@pytest.mark.parametrize("role", ["operators", "viewers"])
def test_people_do_not_bear_the_names_of_the_sites_own_certificates(role, name):
    text = f'[transport]\nlisten = ["tls/127.0.0.1:7447"]\n[transport.security]\nkeys = "keys"\n{role} = ["{name}"]\n'
    with pytest.raises(BadInput, match=rf"'{name}' names a certificate of the site itself"):
        parse_site(GOOD.replace("[[machines]]", f"{text}[[machines]]", 1), "site.toml")


@pytest.mark.parametrize("host", ["127.evil.example", "127.0.0.1.evil.example", "127", "localhost.evil.example"])
def test_a_name_that_looks_like_loopback_is_none(host):
    with pytest.raises(BadInput, match="is reachable from other computers"):
        parse_site(GOOD.replace("[[machines]]", f'[transport]\nlisten = ["tcp/{host}:7447"]\n[[machines]]', 1), "site.toml")


@pytest.mark.parametrize("key", ["limits = {output = [inf, inf]}", "limits = {seconds = inf}", "bursts = {every_seconds = inf}", "bursts = {severity = nan}"])
def test_a_limit_is_finite(key):
    with pytest.raises(BadInput, match="finite number"):
        parse_site(f"{GOOD}\n{key}\n", "site.toml")


def test_deep_nesting_is_a_sentence():
    with pytest.raises(BadInput, match="not a TOML file"):
        parse_site("x = " + 5000 * "[" + 5000 * "]", "site.toml")


@pytest.mark.parametrize("key", ['[web]\nlisten = "127.0.0.1:65536"', '[transport]\nlisten = ["tcp/127.0.0.1:65536"]', "[review]\nport = 65536"])
def test_a_port_that_no_computer_has_is_refused(key):
    with pytest.raises(BadInput, match="65535"):
        parse_site(GOOD.replace("[[machines]]", f"{key}\n[[machines]]"), "site.toml")
