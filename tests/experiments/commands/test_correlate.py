"""`eairl correlate`: a learned reward beside the true one, on episodes of a file."""

import json

import numpy as np

from eairl_jax import demonstrations
from eairl_jax.experiments.pipeline.places import shipped_demonstrations


def test_a_line_for_each_seed_and_all_figures_in_a_file(finished, tmp_path, run, capsys):
    shipped = shipped_demonstrations("pendulum")
    assert run("correlate", finished, "--demos", shipped, "--json", tmp_path / "figures.json") == 0
    figures = json.loads((tmp_path / "figures.json").read_text())
    np.testing.assert_allclose(figures["true"], demonstrations.returns(demonstrations.load(shipped)), rtol=1e-6)
    correlations = [np.corrcoef(learned, figures["true"])[0, 1] for learned in figures["learned"]]
    np.testing.assert_allclose(figures["pearson"], correlations, rtol=1e-6)
    said = capsys.readouterr().out
    assert all(f"{value:.3f}" in said for value in (*figures["pearson"], *figures["spearman"]))
    again = demonstrations.save(tmp_path / "again", demonstrations.load(shipped), {"task": "pendulum"})
    assert run("correlate", finished / "reward", "--demos", shipped, again) == 0
    assert "40 episodes" in " ".join(capsys.readouterr().out.split())


def test_what_has_no_reward_or_no_returns_is_refused(finished, tmp_path, run, capsys):
    shipped = shipped_demonstrations("pendulum")
    assert run("correlate", tmp_path, "--demos", shipped) == 2
    assert "holds no reward.json" in capsys.readouterr().err
    without = demonstrations.load(shipped)._replace(reward=None)
    path = demonstrations.save(tmp_path / "without", without, {"task": "pendulum"})
    assert run("correlate", finished, "--demos", path) == 2
    assert "lacks reward: a reward is compared by both" in capsys.readouterr().err
    assert run("correlate", finished, "--demos", shipped_demonstrations("point_maze_left")) == 2
    assert "point_maze_left.npz has observations of length 2" in capsys.readouterr().err


def test_the_episodes_that_no_reward_has_seen_are_of_all_qualities():
    folder = shipped_demonstrations("half_cheetah").parent / "unseen"
    sets = {int(path.stem.partition("-")[2]): demonstrations.load(path) for path in folder.glob("half_cheetah-*.npz")}
    means = [demonstrations.returns(sets[iterations]).mean() for iterations in sorted(sets)]
    assert len(means) == 5
    assert means == sorted(means)
    assert means[0] < 0 < 2000 < means[-1]
    seen = demonstrations.load(shipped_demonstrations("half_cheetah", "half"))
    assert not any(np.isin(each.obs[:, 1], seen.obs[:, 1]).mean() > 0.5 for each in sets.values())
