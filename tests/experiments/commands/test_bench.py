"""`eairl bench`: every figure is printed and written."""

import json

import numpy as np
import pytest

from eairl_jax.experiments.commands import bench


@pytest.mark.slow
@pytest.mark.parametrize("methods", [("gail",), ("eairl", "gail")], ids=["one", "two"])
def test_bench_measures_methods_in_turns(tmp_path, tiny, monkeypatch, capsys, run, table, methods):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    monkeypatch.setattr(bench, "shards_for", lambda lanes, num_envs: 2)  # so few environments would have one device
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
