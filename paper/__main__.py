"""`osc-contact reproduce`, also `python -m paper`: the figures and studies, by their names."""

from pathlib import Path
from typing import Annotated

import typer

from osc_contact.errors import InvalidInputError
from osc_contact.lab.cli.console import (
    DurationOption,
    JsonOption,
    PlantOption,
    SeedOption,
    SetOption,
    exit_codes,
    load_task,
    out,
    require,
    require_report,
    say,
)
from osc_contact.lab.reports.report import write_json
from paper import figures
from paper.report import (
    REPRODUCIBLE,
    STUDIES,
    WITH_SAMPLES,
    make,
    names_of,
    typed,
    write_paper_report,
)
from paper.selection_laws import selection_of
from paper.study import Ask, table_of

__all__ = ["app", "reproduce", "selection_of"]

NAMES = sorted(REPRODUCIBLE, key=lambda name: (name[:3] != "fig", name))

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


@app.command()
def reproduce(
    figure: Annotated[
        str,
        typer.Argument(
            help=f"{' | '.join(NAMES)} | all (of the paper, fast studies, report.html)",
            metavar="FIGURE",
        ),
    ],
    plant: PlantOption = None,
    duration: DurationOption = None,
    out_dir: Annotated[Path, typer.Option("--out", help="folder for the figures")] = Path(
        "out/figures"
    ),
    seed: SeedOption = 0,
    samples: Annotated[
        int | None, typer.Option(min=1, help="of a study that varies something")
    ] = None,
    set_: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Make the paper's figures from our own data, studies beside them, and a report on them all."""
    with exit_codes():
        names = names_of(figure)
        require("matplotlib")
        drawn = [name for name in names if name not in STUDIES]
        if not drawn and plant is not None:
            raise InvalidInputError(f"{figure} chooses its own plants; leave --plant out")
        if samples is not None and not WITH_SAMPLES.issuperset(names):
            raise InvalidInputError(f"nothing is sampled for {figure}; leave --samples out")
        scenario = load_task(figures.SCENARIO, set_ if drawn else None, plant, duration)
        if figures.NEED_RUN.intersection(drawn):
            require_report(scenario)
        result = make(
            names,
            out_dir,
            scenario,
            Ask(seed, duration, () if drawn else tuple(set_ or ()), samples),
            typed(plant, duration, seed, set_ or ()),
        )
        for one in result.made.values():
            for path in one.files:
                say(f"written: {path}")
        if figure == "all":
            verdicts = result.verdicts().items()
            out.print(table_of("the paper's figures", "figure; verdict", verdicts))
            say(f"written: {write_paper_report(result, out_dir / 'report.html')}")
        if json_file:
            write_json(result.as_dict(), json_file)


if __name__ == "__main__":
    app()
