"""The command line: what scripts rely on, and what people read."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from auv_mcm import __version__
from auv_mcm.cli import main
from auv_mcm.kernels import Loaded
from auv_mcm.settings.config import Config, parse_config
from auv_mcm.shell.registry import COMMAND_GROUPS, COMMANDS

ROOT = Path(__file__).parents[2]


def run(*arguments: str, code: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *(["-c", code] if code else ["-m", "auv_mcm"]), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def error_of(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error."""
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("auv-mcm: ")
    return lines[0]


@pytest.mark.parametrize(
    "command",
    [(), *((name,) for name in ("replay", "run", "check", "config", "bench", "augment", "train", "calibrate", "hil"))],
)
def test_help_says_what_the_command_does_shows_examples_and_exit_codes(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit) as ended:
        main([*command, "--help"])
    text = capsys.readouterr().out
    assert ended.value.code == 0
    assert "5 self-check failed" in text
    assert "examples:" in text or not command
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize(
    "arguments",
    [
        *([], ["nonsense"], ["replay"], ["config"], ["config", "--write", "a", "--schema"], ["bench", "everything"]),
        ["replay", "a.xtf", "--out", "o", "--threads", "0"],
        ["replay", "a.xtf", "--out", "o", "--chunk-bytes", "many"],
        ["replay", "a.xtf", "--out", "o", "--speed", "warp"],
        ["augment", "a.xtf", "--out", "o"],
        *(
            ["calibrate"],
            ["calibrate", "--speed", "0"],
            ["calibrate", "--speed", "nan"],
            ["calibrate", "--speed", "2", "--duty", "1.5"],
        ),
    ],
)
def test_bad_usage_is_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2


@pytest.mark.parametrize(
    ("arguments", "usage", "message"),
    [
        (["replay", "a.xtf", "--out", "o", "--thread-count", "2"], "replay", "unrecognized arguments: --thread-count"),
        (["check", "--confg=vehicle.yaml"], "check", "did you mean --config?"),
        (["calibrate", "budget", "--speed", "2", "--sped", "2"], "calibrate budget", "did you mean --speed?"),
        (["train", "--out", "o.json", "--worker-count", "3"], "train", "unrecognized arguments: --worker-count"),
        (["--verbose", "check"], "", "unrecognized arguments: --verbose"),
        # The beginning of an option is not taken for the whole.
        (["train", "--ou", "x"], "train", "the following arguments are required: --out"),
        (["train", "--out", "x", "--work", "3"], "train", "did you mean --workers?"),
        (["replay", "a.xtf", "--out", "o", "--thread", "2"], "replay", "did you mean --threads?"),
        (["calibrate", "odds", "--out", "x", "--crowd", "3"], "calibrate odds", "did you mean --crowded?"),
        (["bench", "domains", "--first", "3"], "bench domains", "unrecognized arguments: --first"),
        (["replay", "a.xtf", "--outt", "o"], "replay", "did you mean --out?"),
        (["replay", "a.xtf", "--speed", "rel"], "replay", "did you mean real?"),
        (["reply", "a.xtf"], "", "did you mean replay?"),
        (["zzz"], "", "choose from replay, info, view"),
    ],
)
def test_a_wrong_flag_or_word_is_refused_with_the_usage_of_its_own_command_and_the_nearest(
    arguments: list[str], usage: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "sim_replay.fitting.cascade.train_cascade.train_model", lambda *_, **__: pytest.fail("the training began")
    )
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    text = capsys.readouterr().err
    assert ended.value.code == 2
    assert text.startswith(f"usage: auv-mcm {usage} [-h]".replace("  ", " "))
    assert message in text


@pytest.mark.parametrize("separator", [[], ["--"]])
def test_train_takes_an_option_as_its_first_argument(
    separator: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(
        "sim_replay.fitting.cascade.train_cascade.train_model", lambda spec, out, **_: asked.append((spec, out))
    )
    assert main(["train", *separator, "--out", str(tmp_path / "model.json")]) == 0
    assert asked == [(None, tmp_path / "model.json")]
    assert "model.json" in capsys.readouterr().out


def test_module_and_version() -> None:
    assert run("--version").stdout == f"auv-mcm {__version__}\n"


def test_a_log_that_is_not_there_is_exit_code_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(tmp_path / "none.xtf"), "--out", str(tmp_path / "out")]) == 3
    assert "none.xtf does not exist" in error_of(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", [["replay", "a.xtf", "--out", "o"], ["run"]])
@pytest.mark.parametrize(
    ("content", "message"), [(b"sonar: {typo: 1}", "typo"), (b"\xff\xfe", "UTF-8"), (None, "No such file")]
)
def test_a_bad_configuration_is_exit_code_2(
    command: list[str], content: bytes | None, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.yaml"
    if content is not None:
        path.write_bytes(content)
    assert main([*command, "--config", str(path)]) == 2
    text = error_of(capsys)
    assert message in text
    assert "c.yaml" in text


def test_run_without_a_source_says_what_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run"]) == 2
    assert "service.source is empty" in error_of(capsys)


def test_config_write_prints_or_writes_what_reads_back_and_never_overwrites(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "--write"]) == 0
    assert parse_config(capsys.readouterr().out, "stdout") == Config()
    path = tmp_path / "vehicle.yaml"
    assert main(["config", "--write", str(path)]) == 0
    capsys.readouterr()
    before = path.read_bytes()
    assert parse_config(before.decode(), "file") == Config()
    assert main(["config", "--write", str(path)]) == 2
    assert "not overwritten" in error_of(capsys)
    assert path.read_bytes() == before
    assert main(["config", "--write", str(tmp_path / "no" / "folder.yaml")]) == 2


def test_config_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--schema"]) == 0
    assert "SonarConfig" in json.loads(capsys.readouterr().out)["$defs"]


def test_check_reports_every_part_and_passes_here(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check"]) == 0
    text = capsys.readouterr().out
    parts = (
        "python",
        "numpy",
        "mcap",
        "C kernels",
        "plug-ins",
        "simulator kernels",
        "configuration",
        "clock",
        "output directory",
        "perception process",
    )
    for part in parts:
        assert part in text
    assert text.splitlines()[-1].startswith(("all good", "nothing failed, "))


def test_check_of_a_bad_configuration_is_exit_code_5_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.yaml").write_text("sonar: {typo: 1}")
    assert main(["check", "--config", str(tmp_path / "c.yaml")]) == 5
    text = capsys.readouterr().out
    assert "typo" in text
    assert "perception process" in text
    assert "1 failed" in text


@pytest.mark.usefixtures("without_perception")
def test_check_names_every_model_file_that_is_broken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "broken").write_text("x")
    (tmp_path / "c.yaml").write_text(
        "detect: {seabed_model: broken, performance: broken}\nconfirm: {targets: broken}".replace(
            "broken", str(tmp_path / "broken")
        )
    )
    assert main(["check", "--config", str(tmp_path / "c.yaml")]) == 5
    failed = [line.split(maxsplit=1)[1] for line in capsys.readouterr().out.splitlines() if line.startswith("FAILED")]
    for name in ("mines expected", "seabed model", "performance tables"):
        assert any(line.startswith(name) for line in failed), name


@pytest.mark.usefixtures("without_perception")
def test_check_warns_of_a_udp_port_that_hears_every_sender(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.yaml").write_text("ports: [{name: pilot, link: 'udp://0.0.0.0:6001', device: imc}]")
    main(["check", "--config", str(tmp_path / "c.yaml")])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "peer=" in line]
    assert line.startswith("warning port pilot")
    assert "grant control" in line


@pytest.mark.usefixtures("without_perception")
@pytest.mark.parametrize(
    ("config", "name", "says"),
    [
        (
            "ports: [{name: nav, link: 'serial:///dev/ttyNONE9?baud=4800', device: nmea0183}]",
            "port nav",
            "/dev/ttyNONE9: no such device",
        ),
        ("service: {source: ports}", "configuration", "service.source is 'ports', but no port is configured"),
        ("service: {source: 'replay:///no/such/mission.xtf'}", "configuration", "/no/such/mission.xtf does not exist"),
        ("service: {output_directory: /proc/self/status}", "output directory", "is not a directory"),
        (
            "detect: {performance: /no/such/tables.json}",
            "performance tables",
            "detect.performance /no/such/tables.json: No such file",
        ),
        (
            "detect: {model: damaged.json}",
            "detector",
            "damaged.json: Input data was truncated. Train the model anew or take",
        ),
        (
            "detect: {model: /no/such/model.json}",
            "detector",
            "No such file or directory. Name a model file, or 'shipped'",
        ),
    ],
)
def test_check_of_what_a_mission_would_fail_by_is_exit_code_5(
    config: str,
    name: str,
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "damaged.json").write_text('{"format_version": 1')
    (tmp_path / "c.yaml").write_text(config)
    assert main(["check", "--config", str(tmp_path / "c.yaml")]) == 5
    failed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAILED")]
    assert name in failed[0]
    assert says in failed[0]


@pytest.mark.parametrize("module", ["mcap", "msgspec", "yaml", "numpy"])
def test_check_finds_a_base_package_that_cannot_be_imported(module: str) -> None:
    code = f"import sys; sys.modules['{module}'] = None; from auv_mcm.cli import main; sys.exit(main(['check']))"
    done = run(code=code)
    assert done.returncode == 5, done.stderr
    assert "Traceback" not in done.stderr
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    assert any("cannot be imported" in line and "python -m pip install auv-mcm" in line for line in failed)


BASE_ALONE = """
import sys
from importlib import metadata
from auv_mcm.cli import main

version, bench = metadata.version, ("pyxtf", "rich", "matplotlib", "jinja2", "dask", "distributed", "tifffile", "h5py")

def of_base(name):
    if name in bench:
        raise metadata.PackageNotFoundError(name)
    return version(name)

metadata.version = of_base
sys.modules |= dict.fromkeys((*bench, "sim_replay"))
code = main(["check"])
try:
    main(["run", "--help"])
except SystemExit as ended:
    sys.exit(code or ended.code)
"""


def test_the_base_checks_itself_and_runs_without_the_bench_and_its_packages() -> None:
    done = run(code=BASE_ALONE)
    assert done.returncode == 0, done.stdout + done.stderr
    (extra,) = [line for line in done.stdout.splitlines() if "extra bench" in line]
    assert extra.startswith("warning")
    assert "usage: auv-mcm run" in done.stdout


@pytest.mark.usefixtures("without_perception")
def test_check_notices_kernels_that_disagree(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from auv_mcm import kernels
    from auv_mcm.kernels import viterbi

    if kernels.backend() != "c":
        pytest.skip(f"no C kernels: {kernels.loaded().reason}")
    right = viterbi.viterbi_forward_numpy
    monkeypatch.setattr(viterbi, "viterbi_forward_numpy", lambda *a: (right(*a)[0] + 1e-9, right(*a)[1]))
    assert main(["check"]) == 5
    assert "NOT EQUAL" in capsys.readouterr().out


@pytest.mark.usefixtures("without_perception")
def test_check_says_loudly_that_numpy_does_the_work_of_the_kernels(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("auv_mcm.kernels.loaded", lambda: Loaded(None, "not built: install a C compiler"))
    main(["check"])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "C kernels" in line]
    assert line.startswith("warning")
    assert "NUMPY DOES THEIR WORK" in line
    assert "not built: install a C compiler" in line


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (OSError(28, "Full", "/out/report.html"), 4, "/out/report.html: Full. Make room on its disk"),
        (OSError(13, "No", "a/b"), 4, "a/b: No. Check the permissions of it and of the folders above it"),
        (OSError(9, "Bad file descriptor"), 4, "input or output: Bad file descriptor"),
    ],
)
def test_ctrl_c_and_errors_of_the_system_are_one_line_and_an_exit_code(
    raised: BaseException, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sim_replay.replay.replay", Mock(side_effect=raised))
    assert main(["replay", "a.xtf", "--out", "o"]) == code
    assert error_of(capsys) == f"auv-mcm: {words}"


def test_without_the_bench_extra_replay_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "a.xtf").write_bytes(b"\x7b" * 2048)
    command = ["replay", str(tmp_path / "a.xtf"), "--out", str(tmp_path / "out")]
    code = f"import sys; sys.modules['pyxtf'] = None; from auv_mcm.cli import main; sys.exit(main({command}))"
    done = run(code=code)
    assert done.returncode == 2
    assert done.stderr == "auv-mcm: this command needs the package pyxtf: python -m pip install 'auv-mcm[bench]'\n"


@pytest.mark.parametrize("command", ["simulate", "hil"])
def test_lists_need_no_bench_extra(command: str) -> None:
    without = (
        "import sys; sys.modules.update(dict.fromkeys(('pyxtf', 'rich', 'matplotlib', 'jinja2', 'dask', "
        "'distributed')))"
    )
    done = run(code=f"{without}; from auv_mcm.cli import main; sys.exit(main(['{command}', '--list']))")
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) > 5


def test_without_a_base_package_run_says_what_to_install(tmp_path: Path) -> None:
    port = "{name: a, link: 'udp://127.0.0.1:0?peer=127.0.0.1:9', device: nmea0183}"
    (tmp_path / "c.yaml").write_text(
        f"service: {{source: ports, output_directory: '{tmp_path / 'out'}'}}\nports: [{port}]"
    )
    without = "import sys; sys.modules.update({'mcap': None, 'mcap.writer': None}); from auv_mcm.cli import main"
    # Perception is spawned, and imports the main module anew.
    (tmp_path / "main.py").write_text(f"if __name__ == '__main__':\n    {without}; sys.exit(main(sys.argv[1:]))\n")
    command = [sys.executable, str(tmp_path / "main.py"), "run", "--config", str(tmp_path / "c.yaml")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1] == "auv-mcm: the package mcap is missing: python -m pip install auv-mcm"


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    command = f"{sys.executable} -m auv_mcm config --schema | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_process_that_serves_stays_lean() -> None:
    code = (
        "import sys; import auv_mcm.cli; start = set(sys.modules)\n"
        "import auv_mcm.shell.serve, sim_replay.logs.recorded\n"
        "print(sorted({'numpy'} & start), sorted({'cv2', 'scipy', 'matplotlib', 'rich', 'jinja2', 'can'} & "
        "set(sys.modules)))"
    )
    assert run(code=code).stdout == "[] []\n", "the command starts without numpy, the service runs without the others"


def test_help_lists_every_command_once_by_purpose_and_fits_the_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert {name for names in COMMAND_GROUPS.values() for name in names} >= set(COMMANDS)
    for command in ([], ["replay"], ["view"], ["check"], ["hil"], ["score"]):
        with pytest.raises(SystemExit):
            main([*command, "--help"])
        text = capsys.readouterr().out
        prose = [line for line in text.splitlines() if not line.startswith("  ")]
        assert max(map(len, prose)) <= 80
        for name in COMMANDS if not command else ():
            assert len([line for line in text.splitlines() if line.startswith(f"  {name} ")]) == 1


def test_a_list_in_a_help_has_a_line_for_each_item(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    lines = capsys.readouterr().out.splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("all:          every stage's time"))
    assert lines[at + 1] == " " * 14 + "instead; and under stress"


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab", reason="completion needs the package shtab of the extra bench")
    with pytest.raises(SystemExit) as ended:
        main(["--completion", shell])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "replay" in text
    assert "--geotiff" in text or shell == "tcsh"


@pytest.mark.usefixtures("without_perception")
def test_the_self_check_speaks_json_a_finding_a_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code = main(["check", "--json", "missing.xtf"])
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert code == 5
    assert {tuple(one) for one in found} == {("name", "verdict", "detail")}
    assert [one["name"] for one in found if one["verdict"] == "FAILED"] == ["log missing.xtf"]


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="this system does not count threads in /proc")
def test_a_command_begins_no_threads_for_products_of_matrices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    code = (
        "import sys; from auv_mcm.cli import main; main(sys.argv[1:]); import numpy; "
        "print(open('/proc/self/status').read().partition('Threads:')[2].split()[0])"
    )
    assert run("config", "--schema", code=code).stdout.splitlines()[-1] == "1"
