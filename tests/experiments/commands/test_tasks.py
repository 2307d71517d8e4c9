"""`eairl tasks`: every task, its sizes and its returns."""

from eairl_jax import envs


def test_every_task_is_listed(run, table, capsys):
    assert run("tasks") == 0
    printed = table(capsys)
    for task in envs.TASKS:
        assert sum(task in line for line in printed.splitlines()) >= 2
    assert "-148.37" in printed
    assert "passage left" in printed
