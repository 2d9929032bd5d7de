"""Check the benchmark's frame metrics and exact intervals against scikit-learn and SciPy.

  check_metrics.py CASES.json

The cases are random labels and decisions with the figures that the benchmark gives for them, written by
`cargo run -p slipsense-eval --example metric_cases`. Confusion, accuracy, macro F1, precision, recall
and F1 of each class, slip among frames with contact, the Clopper-Pearson interval and the Poisson bound
are worked out again. The largest differences are printed; the exit status is 1 if one is above 1e-9
(intervals: 1e-6).
"""

import json
import sys

import numpy as np
from scipy import stats
from sklearn import metrics

FIGURES_WITHIN = 1e-9
INTERVALS_WITHIN = 1e-6
SLIP = 2


def check(case, differences):
    """Add the differences of one case."""
    label, decided, figures = np.array(case["label"]), np.array(case["class"]), case["figures"]

    def compare(what, found, expected):
        if found is None or expected is None:
            difference = 0.0 if found is expected else np.inf
        else:
            difference = abs(found - expected)
        differences[what] = max(differences.get(what, 0.0), difference)

    def compare_class(name, found, label, decided, which):
        """Precision, recall and F1 of a class; None where there is nothing to divide by."""
        expected = metrics.precision_recall_fscore_support(label, decided, labels=[which], zero_division=np.nan)
        for key, [value] in zip(["precision_share", "recall_share", "f1"], expected):
            compare(f"{key} of {name}", found[key], None if np.isnan(value) else value)

    confusion = metrics.confusion_matrix(label, decided, labels=[0, 1, 2])
    compare("confusion", float(np.abs(confusion - figures["confusion_frames"]).max()), 0.0)
    compare("accuracy", figures["accuracy_share"], metrics.accuracy_score(label, decided))
    compare("macro F1", figures["macro_f1"], metrics.f1_score(label, decided, average="macro"))
    for which, found in enumerate(figures["classes"]):
        compare_class(found["name"], found, label, decided, which)
    touched = label != 0
    if touched.any():
        compare_class("slip in contact", figures["contact_only_slip"], label[touched], decided[touched], SLIP)
    quiet = label != SLIP
    share = float((decided[quiet] == SLIP).mean()) if quiet.any() else None
    compare("FPR of non-slip", figures["fpr_of_non_slip_share"], share)

    hits = int((label == decided).sum())
    interval = stats.binomtest(hits, len(label)).proportion_ci(0.95, method="exact")
    for found, expected in zip(case["accuracy_interval"], interval):
        compare("Clopper-Pearson interval", found, float(expected))
    bound = stats.chi2.ppf(0.95, 2 * (hits + 1)) / 2 / 2.5
    # Relative: the bound can be large.
    compare("Poisson bound interval", case["rate_bound_per_hour"] / bound, 1.0)


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        cases = json.load(file)
    differences = {}
    for case in cases:
        check(case, differences)
    bad = False
    for what, difference in differences.items():
        within = INTERVALS_WITHIN if "interval" in what else FIGURES_WITHIN
        wrong = not difference <= within
        bad |= wrong
        print(f"{what}: largest difference {difference:.1e}{' WRONG' if wrong else ''}")
    print(f"{len(cases)} cases against scikit-learn and SciPy: {'DIFFERENT' if bad else 'equal'}")
    sys.exit(bad or not cases)


if __name__ == "__main__":
    main()
