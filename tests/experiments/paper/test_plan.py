"""What is planned: names, order, and what is missing."""

from eairl_jax.experiments.paper.plan import EXPERIMENTS, FIGURES, Planned, cheapest_first, is_wanted, missing


def test_names_say_method_form_and_everything_that_differs():
    assert Planned("ant", "bc").name == "bc"
    assert Planned("ant", "airl_s").name == "airl_s-s"
    assert Planned("ant", "eairl", "separable", settings=("lambda_i=1",), tuned=True).name == (
        "eairl-separable+lambda_i=1+tuned"
    )
    longer = Planned("ant", "eairl", target="crippled_ant", retrain_settings=("iterations=9",))
    assert longer.identity == ("eairl-sa+retrain_iterations=9", "ant", "crippled_ant", "last")
    assert Planned("ant", "eairl").identity == ("eairl-sa", "ant", None, None)


def test_the_purpose_is_a_reward_where_there_is_a_target():
    assert Planned("ant", "eairl").purpose == "imitate"
    assert Planned("ant", "eairl", target="ant").purpose == "reward"


def test_nothing_is_planned_twice():
    for experiments in EXPERIMENTS.values():
        identities = [planned.identity for planned in experiments]
        assert len(identities) == len(set(identities))
    assert set(FIGURES.values()) <= set(EXPERIMENTS)


def test_cheap_tasks_come_first_and_what_the_paper_does_not_have_last():
    ordered = cheapest_first(EXPERIMENTS)
    assert len(ordered) == sum(map(len, EXPERIMENTS.values()))
    names = [name for name, _ in ordered]
    first_ablation = names.index("ablations")
    assert list(dict.fromkeys(names[first_ablation:])) == ["ablations", "sources", "imperfect", "styles"]
    tasks = list(dict.fromkeys(planned.task for _, planned in ordered[:first_ablation]))
    assert tasks == ["point_maze_left", "point_maze_right", "pendulum", "swimmer", "half_cheetah", "ant"]
    ants = [planned.target for _, planned in ordered[:first_ablation] if planned.task == "ant"]
    assert ants.index("crippled_ant") == ants.count(None)


def test_what_is_wanted():
    early = Planned("ant", "eairl", target="crippled_ant", rule="iteration=100")
    assert is_wanted(early, (), quick=False)
    assert is_wanted(early, ("ant",), quick=False)
    assert not is_wanted(early, ("pendulum",), quick=False)
    assert not is_wanted(early, (), quick=True)


def test_what_is_missing_comes_with_the_command_that_trains_it(make_result, results_of):
    planned = EXPERIMENTS["table2"]
    trained = [make_result(each.name, [1.0], each.task) for each in planned if each.task != "ant"][1:]
    lacking = [each for each in missing(results_of(trained)) if each.experiment == "table2"]
    assert lacking[0].names == ["behaviour cloning"]
    assert [(each.task, len(each.names), each.command_line) for each in lacking] == [
        (planned[0].task, 1, f"eairl reproduce table2 --task {planned[0].task}"),
        ("ant", sum(each.task == "ant" for each in planned), "eairl reproduce table2 --task ant"),
    ]


def test_missing_transfers_say_their_target_where_a_source_has_several(results_of):
    (left,) = [each for each in missing(results_of()) if (each.experiment, each.task) == ("sources", "point_maze_left")]
    assert left.names[:2] == ["EAIRL in point_maze_middle (last)", "EAIRL in point_maze_double (last)"]
    assert len(set(left.names)) == len(left.names) == 8


def test_missing_transfers_say_their_rule(results_of):
    names = [name for each in missing(results_of()) if each.experiment == "table1" for name in each.names]
    assert {"EAIRL (random)", "EAIRL (back in the source)", "EAIRL (iteration=40)"} <= set(names)
