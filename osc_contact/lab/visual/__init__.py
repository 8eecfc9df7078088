"""Pictures of a run: three-dimensional pages, plots, contact pictures.

Everything is written to files or returned as a matplotlib figure; only the live view opens a
socket, on 127.0.0.1, in a separate process. One palette serves all pictures, so that a contact
keeps its colour from the scene to the plots. It is the colour-blind-safe palette of Okabe and Ito
(2008).
"""

OKABE_ITO: dict[str, str] = {
    "black": "#000000",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "green": "#009E73",
    "yellow": "#F0E442",
    "blue": "#0072B2",
    "vermillion": "#D55E00",
    "purple": "#CC79A7",
}

CONTACT_COLOURS: tuple[str, ...] = tuple(
    OKABE_ITO[name] for name in ("blue", "vermillion", "green", "purple", "orange", "sky")
)


def contact_colour(index: int) -> str:
    """Colour ``#RRGGBB`` of the contact with this index, the same in every picture."""
    return CONTACT_COLOURS[index % len(CONTACT_COLOURS)]
