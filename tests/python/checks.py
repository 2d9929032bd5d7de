"""What the checks share: counting mismatches, and stopping at the first one."""

import sys

import numpy as np

SHOWN = 20


class Checks:
    """Every comparison is counted, the first mismatches are printed."""

    def __init__(self):
        self.count = self.bad = 0

    def true(self, what, right):
        self.count += 1
        if not right:
            self.bad += 1
            if self.bad <= SHOWN:
                print(f"mismatch: {what}")

    def equal(self, what, got, want):
        """Compares values, or arrays of equal shape."""
        if isinstance(got, np.ndarray) or isinstance(want, np.ndarray):
            right = np.array_equal(got, want)
        else:
            right = got == (list(want) if isinstance(want, range) else want)
        # The text of an array takes long to make.
        self.true(what if right else f"{what}: got {got!r}, want {want!r}", right)

    def decision(self, index, message, logits_q8, predictions, piezo):
        """Slip message `index` against its row of `predictions.npz`, and its sums against the scans."""
        at, sensors = f"slip message {index}", piezo.shape[1]
        self.equal(f"{at}, class", message.class_index, predictions["class"][index])
        self.equal(f"{at}, logits", logits_q8, ((predictions["logits"][index] + 2) >> 2).clip(-32768, 32767))
        for flag in ("slip", "may_begin"):
            self.equal(f"{at}, {flag}", int(getattr(message, flag)), predictions[flag][index])
        sums = [contact.count_sum for contact in message.contact][:sensors]
        self.equal(f"{at}, sums", sums, piezo[index].sum(axis=(1, 2), dtype=np.uint32))


def require(is_so, what):
    """Print what holds; end with an error where it does not."""
    if not is_so:
        sys.exit(f"error: {what}")
    print(f"  {what}")


def refused(call, *words):
    """Print the ValueError of `call`; end with an error where there is none, or one without these words."""
    try:
        call()
    except ValueError as error:
        require(all(word in str(error) for word in words), f"refused: {error}")
    else:
        sys.exit(f"error: nothing said about {words}")
