"""The package's errors as tests expect them: `with invalid_input("words of its sentence"):`."""

from pytest import mark, raises

import osc_contact as osc


def expecting(error):
    """A function that expects this error with given words: a pattern of its sentence."""

    def expected(words):
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
    """A test that each call is refused with the words before it."""

    @mark.parametrize("words, call", calls.items())
    def test(words, call):
        with expected(words):
            call()

    return test
