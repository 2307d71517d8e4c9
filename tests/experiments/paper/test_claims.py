"""Claims are judged by their thresholds, and only on what was run."""

import pytest

from eairl_jax.experiments.paper.claims import claims, improvements
from eairl_jax.experiments.paper.plan import IMITATED

MAZES = ("point_maze_left", "point_maze_right")


def judged(results_of_all, start):
    """The claim that begins with a text."""
    return next(claim for claim in claims(results_of_all) if claim.text.startswith(start))


@pytest.fixture
def imitations(make_result):
    """A function that makes the results of a method on the tasks of `IMITATED`."""

    def make(name, *returns):
        return [make_result(name, each, task) for task, each in zip(IMITATED, returns, strict=False)]

    return make


@pytest.mark.parametrize(("half_cheetah", "verdict"), [([8.4, 8.4], "yes"), ([8.2, 8.2], "partly")])
def test_imitation_is_judged_by_the_papers_score(imitations, results_of, half_cheetah, verdict):
    # With a random return of 0 the paper has 49.55 / 76.21 = 0.65 (swimmer), 1870.10 / 2139.83 = 0.87 (half_cheetah)
    # and 641.12 / 935.12 = 0.69 (ant). The pendulum's costs give no score then.
    results = imitations("eairl-sa", [12.0, 12.0], [6.2, 6.2], half_cheetah, [6.5, 6.5])
    assert judged(results_of(results), "EAIRL imitates at the paper's level").verdict == verdict
    # A failure decides before everything is run, a success does not.
    incomplete = judged(results_of(results[:3]), "EAIRL imitates at the paper's level")
    assert incomplete.verdict == ("open" if verdict == "yes" else "partly")


def test_our_level_of_imitation_counts_tuned_settings_where_they_exist(imitations, make_result, results_of):
    results = imitations("eairl-sa", [9.6, 9.6], [9.6, 9.6], [4.0, 4.0], [9.6, 9.6])
    assert judged(results_of(results), "Ours: EAIRL imitates at 0.95").verdict == "partly"
    tuned = make_result("eairl-sa+tuned", [9.6, 9.6], "half_cheetah")
    assert judged(results_of([*results, tuned]), "Ours: EAIRL imitates at 0.95").verdict == "yes"


HIGH = [9.0, 9.1, 9.2, 9.3, 9.4]


@pytest.mark.parametrize(
    ("ours", "theirs", "as_well", "better"),
    [
        (HIGH, [1.0, 1.1, 1.2, 1.3, 1.4], "yes", "yes"),
        (HIGH, [9.1, 9.3, 9.4, 9.4, 9.4], "yes", "no"),  # the whole interval is within 0.05
        (HIGH, [9.9, 9.9, 9.9, 9.9, 9.9], "no", "no"),
        ([1.0, 9.0, 1.0, 9.0, 9.0], [9.0, 1.0, 9.0, 1.0, 8.0], "unclear", "no"),  # chance
    ],
)
def test_as_well_and_better(make_result, results_of, ours, theirs, as_well, better):
    results = [
        make_result(name, returns, task)
        for task in IMITATED
        for name, returns in (("eairl-sa", ours), ("gail-sa", theirs), ("airl_s-s", theirs))
    ]
    assert judged(results_of(results), "EAIRL imitates as well as GAIL").verdict == as_well
    assert judged(results_of(results), "EAIRL imitates better than AIRL(s)").verdict == better
    incomplete = judged(results_of(results[:-1]), "EAIRL imitates better than AIRL(s)")
    assert incomplete.verdict == ("open" if better == "yes" else "no")


@pytest.mark.parametrize(
    ("returns", "mean", "every_seed"),
    [([9.6, 9.5], "yes", "yes"), ([9.9, 9.4], "yes", "no"), ([8.0, 8.1], "no", "no")],
)
def test_the_crippled_ant_is_judged_by_the_mean_and_by_every_seed(make_result, results_of, returns, mean, every_seed):
    results = results_of(table1=[make_result("eairl-separable", returns, "ant", "crippled_ant", "last")])
    ours = "Ours: a separable reward transfers to the crippled ant, "
    assert judged(results, f"{ours}0.81").verdict == mean
    assert judged(results, f"{ours}0.95 of the expert in every seed").verdict == every_seed
    assert judged(results, f"{ours}0.95 of the expert in every seed, retrained for 10M").verdict == "open"
    assert judged(results, "Ours: a separable reward transfers to the other maze").verdict == "open"


@pytest.mark.parametrize(("worst", "verdict"), [(-5.4, "yes"), (-5.6, "no")])
def test_a_maze_is_judged_by_the_return_itself(make_result, results_of, worst, verdict):
    # The threshold is a tenth below the expert's -5, though random actions (-50) are far below that.
    results = [
        make_result("eairl-separable", [-5.0, worst], *pair, "last", expert=-5.0, random=-50.0)
        for pair in (MAZES, MAZES[::-1])
    ]
    claim = judged(results_of(table1=results), "Ours: a separable reward transfers to the other maze")
    assert claim.verdict == verdict


def test_what_was_not_run_leaves_every_claim_open(make_result, results_of):
    assert {claim.verdict for claim in claims(results_of())} == {"open"}
    # Results in different tasks cannot be compared.
    apart = results_of([make_result("eairl-sa", [9.0, 9.0]), make_result("gail-sa", [9.0, 9.0], "ant")])
    assert judged(apart, "EAIRL imitates as well as GAIL").verdict == "open"


@pytest.mark.parametrize(("share", "verdict"), [(1.0, "no"), (0.9, "unclear"), (None, "unclear")])
def test_a_low_score_says_nothing_against_a_reward_that_was_not_optimised(
    share, verdict, make_result, make_diagnosis, results_of
):
    diagnosis = None if share is None else make_diagnosis([1.0, 1.0], share)
    low = make_result("eairl-sa", [1.0, 1.0], *MAZES, "last", diagnosis=diagnosis)
    high = make_result("airl_s-s", [9.0, 9.0], *MAZES, "last")
    results = results_of(table1=[low, high])
    assert judged(results, "EAIRL's reward r(s,a) transfers to the other maze").verdict == verdict
    assert judged(results, "In the other maze EAIRL's reward is better than that of AIRL(s)").verdict == verdict


def test_a_reward_back_in_its_source_is_no_transfer(make_result, results_of):
    home = make_result("eairl-sa", [10.0, 10.0], MAZES[0], MAZES[0], "last")
    away = make_result("eairl-sa", [1.0, 1.0], *MAZES, "last")
    start = "EAIRL's reward r(s,a) transfers to the other maze"
    assert judged(results_of(table1=[home]), start).verdict == "open"
    assert judged(results_of(table1=[home, away]), start).verdict == "no"


def test_phi_is_judged_where_it_was_removed(make_result, results_of):
    with_phi = [make_result("eairl-sa", [9.0, 9.1, 9.2], *pair, "last") for pair in (MAZES, MAZES[::-1])]
    without = make_result("eairl-sa+shaping=none", [2.0, 2.1, 2.2], *MAZES, "last")
    separable = [
        make_result(f"eairl-separable+shaping={phi}", [3.0, 3.1, 3.2], *MAZES, "last")
        for phi in ("empowerment", "none")
    ]
    results = results_of(table1=with_phi, ablations=[without, *separable])
    claim = judged(results, "Empowerment's Phi is what makes r(s,a)")
    assert claim.verdict == "yes"
    assert claim.here.startswith("0.91 against 0.21")
    assert judged(results, "Empowerment's Phi is what makes a separable reward").verdict == "no"


def test_improvements_are_over_common_tasks(make_result, results_of):
    results = [
        make_result("eairl-sa", [9.0, 9.0]),
        make_result("eairl-sa", [1.0, 1.0], "ant"),
        make_result("gail-sa", [5.0, 5.0]),
        make_result("gail-sa", [5.0, 5.0], "ant"),
        make_result("bc", [5.0, 5.0]),
    ]
    improvement_over = {each.theirs: each for each in improvements(results_of(results))}
    assert (improvement_over["GAIL"].chance.value, improvement_over["GAIL"].tasks) == (0.5, 2)
    assert (improvement_over["behaviour cloning"].chance.value, improvement_over["behaviour cloning"].tasks) == (1.0, 1)
