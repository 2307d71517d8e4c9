"""The grammar of task names, and file names made of them."""

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax.envs.mjx_task import TaskError
from eairl_jax.envs.names import BRAX, FILE, MODULE, OWN, PLAYGROUND, TaskName, file_name, parse, value_of

IDENTIFIER = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,11}", fullmatch=True)
VALUES = {
    "true": True, "false": False, "null": None, "True": True, "3": 3, "-0.5": -0.5, "1e-3": 1e-3, "mjx": "mjx",
    "(1, 2)": (1, 2), "'3'": "3", "1.2.3": "1.2.3", "": "", "[": "[", "1_": "1_", "(" * 5000: "(" * 5000,
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pendulum", TaskName(OWN, "", "pendulum", {})),
        ("ant?fidelity=exact", TaskName(OWN, "", "ant", {"fidelity": "exact"})),
        ("brax:hopper", TaskName(BRAX, "", "hopper", {})),
        ("brax:ant?backend=mjx&healthy=false", TaskName(BRAX, "", "ant", {"backend": "mjx", "healthy": False})),
        ("playground:Go1?reward.scale=2", TaskName(PLAYGROUND, "", "Go1", {"reward.scale": 2})),
        ("my_tasks.py:make", TaskName(FILE, "my_tasks.py", "make", {})),
        ("/a b/c:d/my.tasks.py:make?n=1", TaskName(FILE, "/a b/c:d/my.tasks.py", "make", {"n": 1})),
        ("package.module:make", TaskName(MODULE, "package.module", "make", {})),
    ],
)
def test_a_name_is_taken_apart(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize(("text", "value"), VALUES.items(), ids=[text[:8] or "empty" for text in VALUES])
def test_values_are_words_literals_or_text(text, value):
    assert value_of(text) == value
    assert type(value_of(text)) is type(value)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("my_tasks.py", "name the function"),
        ("my_tasks.py:", "expected FILE.py:FUNCTION"),
        (":make", "expected FILE.py:FUNCTION"),
        ("ant?", "expected name=value"),
        ("ant?fidelity", "expected name=value"),
        ("ant?=exact", "expected name=value"),
        ("ant?a=1&&b=2", "expected name=value"),
        ("ant?a=1&a=2", "a is given twice"),
    ],
)
def test_what_is_no_name_is_answered_with_a_form_of_names(text, hint):
    with pytest.raises(TaskError, match=re.escape(hint)):
        parse(text)


@given(st.text(max_size=60))
def test_any_text_is_a_name_or_a_clear_error(text):
    with contextlib.suppress(TaskError):
        assert parse(text).origin in (OWN, BRAX, PLAYGROUND, FILE, MODULE)


@given(
    st.sampled_from(["brax:", "playground:", "m.py:", "m:", ""]), IDENTIFIER, st.dictionaries(IDENTIFIER, st.integers())
)
def test_what_is_written_is_read(origin, name, arguments):
    text = origin + name + ("?" if arguments else "") + "&".join(f"{key}={value}" for key, value in arguments.items())
    parsed = parse(text)
    assert (parsed.name, parsed.arguments) == (name, arguments)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pendulum", "pendulum"),
        ("brax:hopper", "brax-hopper"),
        ("playground:CheetahRun", "playground-CheetahRun"),
        ("my_tasks.py:make_env", "my_tasks-make_env"),
    ],
)
def test_plain_names_of_files_need_no_digest(text, expected):
    assert file_name(text) == expected


@given(st.text(max_size=300))
def test_any_name_gives_a_safe_name_of_a_file(text):
    assert re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,80}", file_name(text)) or re.fullmatch(r"\w+", text, re.ASCII)


def test_different_tasks_have_different_names_of_files():
    texts = [
        "brax:ant", "brax:ant?a=1", "brax:ant?a=2", "brax.py:ant", "brax/ant", "brax-ant", "a/b.py:f", "a-b.py:f",
        "a_b.py:f", "b.py:f", "b:f", "/a/b.py:f", "a/b/.py:f", "ant", "ant?", "Ant", "playground:ant",
    ]  # fmt: skip
    assert len({file_name(text) for text in texts}) == len(texts)


@given(st.lists(st.text(alphabet="abA_.:/?=&-py1", min_size=1, max_size=12), unique=True, max_size=30))
def test_names_of_files_do_not_meet(texts):
    assert len({file_name(text) for text in texts}) == len(texts)
