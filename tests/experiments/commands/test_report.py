"""`eairl report`: what it refuses."""

import json


def test_a_report_of_nothing_is_refused(tmp_path, capsys, run):
    assert run("report", "--results", tmp_path) == 2
    assert "holds no results" in capsys.readouterr().err
    for content, hint in (({}, "holds no results of `eairl reproduce`"), ({"rows": [{"name": "bc"}]}, "result 0 of")):
        (tmp_path / "table2.json").write_text(json.dumps(content))
        assert run("report", "--results", tmp_path) == 2
        assert hint in capsys.readouterr().err
