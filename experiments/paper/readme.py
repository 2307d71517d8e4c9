"""Writes the tables of the README anew from `experiments/results`: `python -m eairl_jax.experiments.paper.readme`."""

from __future__ import annotations

import re
from pathlib import Path

from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.paper import results

README = Path("README.md")


def updated(text: str, folder: Path = results.FOLDER) -> str:
    """The README with fresh tables between `<!-- NAME -->` and `<!-- end -->`, for every results file named so."""

    def fresh(found: re.Match) -> str:
        name = found[1]
        tables = results.tables(results.load(folder / f"{name}.json"), paper.TABLES[name])
        return "\n".join([f"<!-- {name} -->", "\n\n".join(map(results.markdown, tables)), "<!-- end -->"])

    return re.sub(rf"<!-- ({'|'.join(paper.TABLES)}) -->\n.*?<!-- end -->", fresh, text, flags=re.DOTALL)


if __name__ == "__main__":
    README.write_text(updated(README.read_text(encoding="utf-8")), encoding="utf-8")
