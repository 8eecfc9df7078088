"""Loading of scenarios from YAML; all errors are reported together, with file, line and cure.

The text is parsed to nodes (never constructed to objects), converted to plain data with the line of
every key, changed by overrides, and only then validated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from osc_contact.errors import ScenarioError, did_you_mean
from osc_contact.lab.scenarios.document import Problems, ScenarioDocument, complaints
from osc_contact.lab.scenarios.schema import Scenario

LARGEST = 1_000_000  #: largest size of a scenario file (bytes); packaged ones have a few thousand
FILES = Path(__file__).parent / "files"  #: folder of the packaged scenarios
Overrides = Mapping[str, str] | Sequence[str]  #: values by path, or sentences path.to.key=value


def load_scenario(name_or_path: str | Path, overrides: Overrides = ()) -> Scenario:
    """Load a packaged scenario by name or a YAML file by path, changed by overrides.

    Args:
        name_or_path: "two_contact_rod" or a path such as "my/scenario.yaml".
        overrides: {"path.to.key": "value"} or ["path.to.key=value"]; list items by index or
            name, as in contacts.left_end.radius=5 mm.

    Raises:
        ScenarioError: there is no such scenario, or errors in the file or an override (all of
            them).
    """
    return Template.open(name_or_path).make(overrides)


def list_scenarios() -> dict[str, str]:
    """Return name → description of the packaged scenarios, sorted by name."""
    return {path.stem: load_scenario(path).description for path in sorted(FILES.glob("*.yaml"))}


def parse_scenario(
    text: str, source: str | Path | None = None, overrides: Overrides = ()
) -> Scenario:
    """Make a scenario from YAML text.

    Args:
        text: YAML text.
        source: file of the text, named in messages; relative URDF paths refer to its folder.
        overrides: values of keys: texts path.to.key=value, or a mapping from paths to values.

    Raises:
        ScenarioError: errors in the text or an override, one in each line, as
            file:line: key.path: cause.
    """
    return Template(text, source).make(overrides)


class Template:
    """Text of a scenario that is parsed once, to make scenarios with different overrides.

    Attributes:
        source: file of the text; None: unknown.
    """

    def __init__(self, text: str, source: str | Path | None = None) -> None:
        """Parse YAML text.

        Args:
            text: YAML text.
            source: file of the text, named in messages; relative URDF paths refer to its folder.

        Raises:
            ScenarioError: errors in the text, one in each line.
        """
        self.source = None if source is None else Path(source)
        problems = Problems(str(self.source or "scenario"))
        if len(text) > LARGEST:
            raise ScenarioError(f"{len(text)} characters; scenarios are read up to {LARGEST}")
        self._document = ScenarioDocument(text, problems)  #: text of the scenario, with its lines
        if not isinstance(self._document.data, dict):
            problems.at_line(1, "expected keys such as name, arms, object; got no group of keys")
            problems.raise_any()

    @classmethod
    def open(cls, name_or_path: str | Path) -> Template:
        """Read a packaged scenario by name or a YAML file by path.

        Raises:
            ScenarioError: there is no such scenario, or its text cannot be read.
        """
        return _template(*read_text(name_or_path))

    def value(self, path: str, overrides: Overrides = ()) -> Any:
        """Value of a key as written, after overrides, before validation; None: not given.

        Args:
            path: keys, list indices or names of items, joined by dots.
            overrides: values of keys: texts path.to.key=value, or a mapping from paths to values.

        Raises:
            ScenarioError: there is no such path, or errors in an override.
        """
        document = self._apply_overrides(overrides)
        document.problems.raise_any()
        return document.value(path)

    def _apply_overrides(self, overrides: Overrides) -> ScenarioDocument:
        """Copy the document, and set the values of overrides in the copy.

        Errors of the overrides are collected in the `problems` of the copy.

        Args:
            overrides: texts path.to.key=value, one text, or a mapping from paths to values.
        """
        document = deepcopy(self._document)
        if isinstance(overrides, Mapping):
            overrides = [f"{path}={value}" for path, value in overrides.items()]
        for item in (overrides,) if isinstance(overrides, str) else overrides:
            path, equals, value = item.partition("=")
            if equals:
                document.override(path.strip(), value)
            else:
                document.problems.at_override(item, "expected path.to.key=value")
        return document

    def make(self, overrides: Overrides = ()) -> Scenario:
        """Make a scenario of the text with overrides.

        Args:
            overrides: values of keys: texts path.to.key=value, or a mapping from paths to values.

        Raises:
            ScenarioError: errors in the text or an override (all of them).
        """
        document = self._apply_overrides(overrides)
        try:
            folder = self.source and self.source.parent
            scenario = Scenario.model_validate(document.data, context={"folder": folder})
        except ValidationError as error:
            for place, complaint in complaints(error, document.data, Scenario):
                document.report(place, complaint)
            document.problems.raise_any()
            raise
        document.problems.raise_any()
        return scenario.with_source(self.source)


@lru_cache(maxsize=32)
def _template(text: str, source: Path) -> Template:
    """Template of a text, which is parsed once: what is made of a template does not change it."""
    return Template(text, source)


def read_text(name_or_path: str | Path) -> tuple[str, Path]:
    """Read the text of a packaged scenario, by name, or of a YAML file, by path.

    Args:
        name_or_path: name of a packaged scenario, or path of a file.

    Returns:
        Text, and path of its file.

    Raises:
        ScenarioError: there is no such scenario, or the file cannot be read or is too large.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml") and len(path.parts) == 1 and not path.is_file():
        packaged = sorted(file.stem for file in FILES.glob("*.yaml"))
        if str(name_or_path) not in packaged:
            raise ScenarioError(
                f"no packaged scenario {str(name_or_path)!r}; {did_you_mean(path.name, packaged)}; "
                "or give the path of a YAML file"
            )
        path = FILES / f"{path.name}.yaml"
    try:
        size = path.stat().st_size
        if size > LARGEST:
            raise ScenarioError(
                f"{path} has {size / 1e6:.1f} MB; scenarios are read up to {LARGEST / 1e6:g} MB"
            )
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"cannot read the scenario file {path}: {error}") from error
    return text, path
