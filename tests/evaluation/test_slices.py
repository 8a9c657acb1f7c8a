import numpy as np

from wordcraft_kg.evaluation.agent_metrics import OPEN_END, binned


def test_bins_hold_their_bounds_and_are_named_by_them():
    values = np.array([0, 1, 2, 3, 4, 9, 10, 1_000])
    found = {
        name: values[mask].tolist()
        for name, mask in binned(values, ((0, 0), (1, 3), (5, 9), (10, OPEN_END)))
    }
    assert found == {"0": [0], "1–3": [1, 2, 3], "5–9": [9], "10+": [10, 1_000]}


def test_the_name_of_the_last_bin_can_be_in_words():
    assert [name for name, _ in binned(np.arange(3), ((2, OPEN_END),), more=" or more")] == [
        "2 or more"
    ]
