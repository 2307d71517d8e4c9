"""`eairl bench`: every figure is printed and written."""

import json

import numpy as np
import pytest

from eairl_jax.experiments.commands import bench


@pytest.mark.slow
@pytest.mark.parametrize("methods", [("gail",), ("eairl", "gail")], ids=["one", "two"])
def test_bench_measures_methods_in_turns(tmp_path, tiny, monkeypatch, capsys, run, table, methods):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    monkeypatch.setattr(bench, "shards_for", lambda lanes, config: 2)  # so few environments would have one device
    path = tmp_path / "figures" / "bench.json"
    settings = [a for a in tiny if "eairl" in methods or not a.startswith("empowerment")]
    assert run("bench", "pendulum", "--method", *methods, "--iterations", 2, "--json", path, "--set", *settings) == 0
    printed = table(capsys)
    written = json.loads(path.read_text())
    simulation, rows = written["simulation"], written["methods"]
    assert (simulation["devices"], simulation["envs"]) == (2, 4)
    ratio = simulation["mjx_steps_per_second"] / simulation["c_steps_per_second"]
    assert simulation["mjx_over_c"] == pytest.approx(ratio)
    assert f"MJX over C {ratio:.2f}" in printed
    assert list(rows) == [f"{method}-sa" for method in methods]
    whole = {"iteration", "iteration, five seeds", "iteration, all devices"}
    stages = {"simulation alone", "rollout", "discriminator", "policy"} | whole
    for name, row in rows.items():
        assert row["env_steps_per_iteration"] == 40
        ms = row["milliseconds"]
        assert set(ms) == stages | ({"empowerment"} if name == "eairl-sa" else set())
        assert all(np.isfinite(x) and x > 0 for x in ms.values())
        assert row["iteration_over_simulation"] == pytest.approx(ms["simulation alone"] / ms["iteration"])
        assert row["five_seeds_over_one"] == pytest.approx(ms["iteration, five seeds"] / ms["iteration"])
        assert row["iteration_steps_per_second"] == pytest.approx(40 / (1e-3 * ms["iteration"]))
        assert row["speedup_of_all_devices"] == pytest.approx(ms["iteration"] / ms["iteration, all devices"])
        assert f"{row['speedup_of_all_devices']:.2f} x the speed of one device" in printed
        assert set(row["compile_seconds"]) == whole
        assert printed.count(name) >= len(methods), "a table of its own and a row beside the others"
    if len(methods) == 1:
        return
    ratio = rows["gail-sa"]["milliseconds"]["iteration"] / rows["eairl-sa"]["milliseconds"]["iteration"]
    assert f"{ratio:.2f}" in next(line for line in reversed(printed.splitlines()) if "gail-sa" in line)


@pytest.mark.slow
def test_bench_measures_along_axes(tmp_path, tiny, capsys, run):
    path, figure = tmp_path / "scale.json", tmp_path / "scale.png"
    scale = ["--scale", "num_envs=2,4", "seeds=1,2", "--json", path, "--figure", figure]
    assert run("bench", "pendulum", "--iterations", 2, *scale, "--set", *tiny) == 0
    printed, written = " ".join(capsys.readouterr().out.split()), json.loads(path.read_text())
    for name, values, steps in (("num_envs", [2, 4], [40, 80]), ("seeds", [1, 2], [40, 80])):
        points, law = written[name]["points"], written[name]["law"]
        assert [point["value"] for point in points] == values
        assert [point["env_steps"] for point in points] == steps
        assert all(point["seconds"] > 0 and point["compile_seconds"] > 0 for point in points)
        assert points[0]["states_gb"] < points[1]["states_gb"]
        assert f"x {name}; the largest deviation is {law['deviation']:.0%}" in printed
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scale", "num_envs=2"], "at least two whole numbers"),
        (["--scale", "seeds=1,2", "--method", "eairl", "gail"], "--scale measures one method"),
        (["--figure", "x.png"], "--figure is of --scale"),
    ],
)
def test_what_cannot_be_measured_along_an_axis_is_refused(run, capsys, monkeypatch, tmp_path, options, message):
    monkeypatch.chdir(tmp_path)
    assert run("bench", "pendulum", *options) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
