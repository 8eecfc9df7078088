"""Expectations of the package's errors: `with invalid_input("words of its sentence"):`."""

from pytest import mark, raises

import osc_contact as osc


def expecting(error):
    """Make a function that expects an error of a class."""

    def expected(words):
        """Context that expects the error with a sentence that matches the pattern `words`."""
        return raises(error, match=words)

    return expected


contact_error = expecting(osc.ContactError)
invalid_input = expecting(osc.InvalidInputError)
model_error = expecting(osc.ModelError)
plant_error = expecting(osc.PlantError)
recording_error = expecting(osc.RecordingError)
scenario_error = expecting(osc.ScenarioError)
viewer_error = expecting(osc.ViewerError)


def refusals(expected, calls):
    """Make a test that each call is refused.

    Args:
        expected: function by `expecting`.
        calls: call by the pattern of its error's sentence.
    """

    @mark.parametrize("words, call", calls.items())
    def test(words, call):
        """Assert that a call is refused with these words."""
        with expected(words):
            call()

    return test
