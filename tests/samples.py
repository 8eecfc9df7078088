"""What every `make test` runs of a long list; `make test-all` runs the others, too."""

from pytest import mark, param


def first(items, count=2):
    """Parameters, one for each item: those behind the first `count` are slow."""
    return [item if i < count else param(item, marks=mark.slow) for i, item in enumerate(items)]


def chosen(items, *names):
    """Likewise with all that are not named."""
    return first([*names, *(item for item in items if item not in names)], len(names))
