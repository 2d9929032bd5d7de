"""The front end, checked: schematic and its pins, simulation against the requirements, the model that the generator uses.

    python check.py OUT [--write]

Prints every figure; exits with 1 if a requirement is missed or a committed table differs. `--write` makes the tables anew.
"""

import json
import logging
import os
import re
import sys
from pathlib import Path

import numpy as np

logging.disable(logging.WARNING)  # schematic.py counts the warnings of the rules; the others are of missing layouts

import former  # noqa: E402
import spice  # noqa: E402
from spice import LINES, parameters  # noqa: E402

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "host-tools/synth/src/film/front_end/table.rs"
CASES = ROOT / "host-tools/synth/src/film/front_end_cases.json"
WIRING = ROOT / "docs/src/board/wiring.md"
EXPONENT, FULL_SCALE_KPA = 0.92, 5000.0
CODES_PER_V = 65536 / 3.3

# Corners of what is not under our control: film and layout, amplifier, capacitors.
BASE = parameters()
SLOW_FILM = {"film__taxel_pf": 0.0, "film__line_pf": BASE["film"]["line_max_pf"]}
CORNERS = {
    "nominal": {},
    "500 pF on each line": SLOW_FILM,
    "500 pF, amplifier 30 % slower": {**SLOW_FILM, "amplifier__gbw_mhz": 0.7 * BASE["amplifier"]["gbw_mhz"]},
    "10 pF, capacitors 5 % high": {"film__taxel_pf": 0.1, "film__line_pf": 10.0,
                                   "column__feedback_pf": 1.05 * BASE["column"]["feedback_pf"],
                                   "output__feedback_pf": 1.05 * BASE["output"]["feedback_pf"]},
}

failures = []


def require(holds, text):
    print(f"  {'ok  ' if holds else 'FAIL'} {text}")
    if not holds:
        failures.append(text)


def patterns():
    """Contact patterns, full scale beside untouched, by name."""
    of = lambda rule: np.fromfunction(np.vectorize(lambda r, c: float(rule(int(r), int(c)))), (LINES, LINES))
    return {
        "one taxel": of(lambda r, c: (r, c) == (9, 0)),
        "a row": of(lambda r, c: r == 9),
        "a column": of(lambda r, c: c == 0),
        "a row and a column": of(lambda r, c: r == 9 or c == 0),
        "all but a row and a column": of(lambda r, c: r != 9 and c != 0),
        "every second row": of(lambda r, c: r % 2),
        "every second column": of(lambda r, c: c % 2),
        "chequered": of(lambda r, c: (r + c) % 2),
        "left half": of(lambda r, c: c < 16),
        "lower half": of(lambda r, c: r < 16),
        "everything": of(lambda r, c: True),
    }


def schematic_checks(out):
    import schematic

    rules, reaches = schematic.write(out)
    for board, (errors, warnings) in rules.items():
        require(errors == warnings == 0, f"{board}: {errors} errors and {warnings} warnings of the electrical rules")
    pins = (ROOT / "src/firmware/bin/app/pins.rs").read_text().partition("pub fn assign")[2]
    field = lambda name: re.findall(r"chip\.(P[A-H]\d+)", re.search(rf"\b{name}: (\[.*?\]|[^,]*),", pins, re.S)[1])
    firmware = dict(zip(schematic.ADDRESS, field("address")))
    firmware |= {f"AOUT{i}": pin for i, pin in enumerate(field("arrays"))}
    firmware |= {f"CS{i}": pin for i, pin in enumerate(field("chip_selects"))}
    for signal in ("can_rx", "can_tx", "sck", "mosi", "miso"):
        firmware[signal.upper()] = field(signal)[0]
    require(firmware == schematic.BOARD, f"{len(firmware)} signals are on the pins that the firmware drives")

    kinds = [("column address A", "COL_A", 1), ("row address A", "ROW_A", 1), ("amplifier of array ", "AOUT", 1),
             ("chip select of accelerometer ", "CS", 1), ("SPI1 SCK", "SCK", 0), ("SPI1 MOSI", "MOSI", 0),
             ("SPI1 MISO", "MISO", 0), ("FDCAN1 RX", "CAN_RX", 0), ("FDCAN1 TX", "CAN_TX", 0)]
    page = {}
    for pin, rest in re.findall(r"^\| (P[A-H]\d+) \|(.*)\|$", WIRING.read_text(), re.M):
        for words, signal, digits in kinds:
            if found := re.search(re.escape(words) + rf"(\d{{{digits}}})", rest):
                page[signal + found[1]] = pin
    require(page == schematic.BOARD, f"{len(page)} signals are on the pins of the wiring page")

    expected = {}
    for signal, pin in firmware.items():
        if signal.startswith("CAN"):
            expected[pin] = {{"CAN_RX": "RXD", "CAN_TX": "TXD"}[signal] + " of the transceiver"}
        elif signal[:-1] in ("AOUT", "CS"):
            expected[pin] = {f"{signal[:-1]} of finger {signal[-1]}"}
        else:
            expected[pin] = {f"{signal} of finger {i}" for i in range(schematic.FINGERS)}
    require(reaches == expected, f"{len(reaches)} pins of the board reach their contacts of the three cables")


def settling(span_v):
    """Every transition of every pattern and corner; those that the same classes of lines describe once. The latest time
    at which a reading is within half a count of 4096, from the address on the pins, ns; the largest error at the trigger
    and as sampled, codes."""
    sc, latest, worst = parameters()["scan"], 0.0, 0.0
    half_count = span_v / 8192
    low, high = 9.0, 0.0
    jobs = {}
    for pattern_name, pattern in patterns().items():
        for slot in range(LINES**2):
            step = spice.transition(pattern, slot)
            jobs.setdefault(json.dumps(step), (step, pattern_name, slot))
    for name in CORNERS:
        p = parameters(**CORNERS[name])
        results = spice.together(lambda job: spice.scan_step(p, *job[0]), jobs.values())
        rows = []
        for (_, pattern_name, slot), data in zip(jobs.values(), results):
            time, pin, held = data[:, 0] * 1e9, data[:, 1], data[:, 2]
            final = pin[-1]
            # Until the ADC's capacitor takes its charge from the pin.
            before = time < sc["trigger_ns"]
            off = time[before][abs(pin[before] - final) > half_count]
            settled = max(off.max(initial=0) - sc["dma_ns"], 0)
            sampled = np.searchsorted(time, sc["trigger_ns"] + parameters()["adc"]["sampling_ns"])
            error = max(abs(pin[before][-1] - final), abs(held[sampled] - final))
            rows.append((settled, error * CODES_PER_V, pattern_name, slot))
            low, high = min(low, data[:, 3].min()), max(high, data[:, 4].max())
        settled, _, pattern_name, slot = max(rows)
        error = max(row[1] for row in rows)
        require(
            error <= half_count * CODES_PER_V,
            f"{name}: {len(jobs)} kinds of transition stand for {LINES**2 * len(patterns())}; settled {settled:.0f} ns after "
            f"the address (slowest: {pattern_name}, slot {slot}), at most {error:.1f} codes off at trigger and sample, "
            f"allowed {half_count * CODES_PER_V:.1f}",
        )
        latest, worst = max(latest, settled), max(worst, error)
    swing = parameters()["amplifier"]["swing_v"]
    require(low > swing and high < 3.3 - swing, f"outputs of columns from {low:.3f} V, of the driver to {high:.3f} V; "
            f"the swing ends {swing} V from 0 and 3.3 V")
    return latest, worst, (low, high)


def margins():
    least = 180.0
    for name in CORNERS:
        p = parameters(**CORNERS[name])
        found = {f"column, {load} taxels at full scale": spice.phase_margin(p, "column", load) for load in (0, 1, 8, 32)}
        found |= {stage: spice.phase_margin(p, stage) for stage in ("common", "output")}
        stage = min(found, key=found.get)
        require(found[stage] >= 45, f"{name}: phase margins from {found[stage]:.0f}° ({stage})")
        least = min(least, found[stage])
    return least


def crosstalk(p, codes, chosen):
    """What the rest of each pattern adds to a taxel, share of full scale, with all tolerances at their worst."""
    vos, worst = p["amplifier"]["offset_uv"] * 1e-6, {}
    jobs = [(name, pattern, own, sign) for name, pattern in chosen.items() for own in (0.0, 0.1, 1.0) for sign in (-1, 1)]

    def job(item):
        name, pattern, own, sign = item
        errors = []
        for r, c in ((9, 0), (9, 20), (20, 0), (20, 21)):
            both = []
            for rest in (pattern, np.zeros((LINES, LINES))):
                g = rest.copy()
                g[r, c] = own
                g, rows, cols = spice.classes(g, [r], [c])
                both.append(codes(spice.driven_row(p, g, rows, cols, 0, [sign * vos] * len(cols)))[0])
            errors.append(abs(both[0] - both[1]))
        return max(errors)

    for (name, *_), error in zip(jobs, spice.together(job, jobs)):
        worst[name] = max(worst.get(name, 0), error)
    return worst


def random_pattern(rng):
    """Conductances relative to full scale: one to four soft patches, sometimes a line, 1 kPa to 5 MPa."""
    kpa = np.zeros((LINES, LINES))
    row, col = np.mgrid[0:LINES, 0:LINES]
    for _ in range(rng.integers(1, 5)):
        peak = np.exp(rng.uniform(0, np.log(FULL_SCALE_KPA)))
        (r, c), (a, b) = rng.uniform(0, LINES, 2), np.exp(rng.uniform(np.log(1.5), np.log(14), 2))
        kpa = np.maximum(kpa, peak * np.maximum(0, 1 - ((row - r) / a) ** 2 - ((col - c) / b) ** 2))
    if rng.random() < 0.3:
        line = kpa if rng.random() < 0.5 else kpa.T
        line[rng.integers(LINES)] = np.exp(rng.uniform(0, np.log(FULL_SCALE_KPA)))
    driven = int(np.argmax(kpa.sum(1))) if rng.random() < 0.7 else int(rng.integers(LINES))
    return (kpa / FULL_SCALE_KPA) ** EXPONENT, driven


def simulated(p, codes, count, seed):
    """(g, driven row, offsets in µV, codes of its 32 taxels) for random patterns, each with all 32 by 32 lines."""
    rng = np.random.default_rng(seed)
    limit = p["amplifier"]["offset_uv"]
    cases = [(*random_pattern(rng), np.clip(rng.normal(0, limit / 3, LINES), -limit, limit)) for _ in range(count)]
    ones = [1] * LINES
    run = lambda case: codes(spice.driven_row(p, case[0], ones, ones, case[1], case[2] * 1e-6))
    return [(*case, result) for case, result in zip(cases, spice.together(run, cases))]


def predict(model, g, row, uv):
    """The model: see `host-tools/synth/src/film/front_end.rs`."""
    by_col = g.sum(0)
    own = model["full_scale"] * g[row] / ((1 + model["row_drop"] * g[row].sum()) * (1 + model["col_drop"] * by_col))
    return model["idle"] + own + uv * (model["offset_per_uv"] + model["leak_per_uv"] * by_col)


def fit(cases):
    """Least squares by Gauss and Newton."""
    names = ["idle", "full_scale", "row_drop", "col_drop", "offset_per_uv", "leak_per_uv"]
    x = np.array([3e3, 57e3, 1e-5, 1e-5, 0.06, 0.03])
    scale = np.array([1e3, 1e4, 1e-4, 1e-4, 0.1, 0.1])
    residual = lambda x: np.concatenate(
        [(predict(dict(zip(names, x)), g, row, uv) - result) / (1 + 0.01 * abs(result - 3e3)) for g, row, uv, result in cases])
    for _ in range(8):
        base = residual(x)
        slope = np.stack([(residual(x + 1e-4 * s * e) - base) / 1e-4 for s, e in zip(scale, np.eye(len(x)))], 1)
        x = x - scale * np.linalg.lstsq(slope, base, rcond=None)[0]
    return dict(zip(names, map(float, x)))


def off_share(model, cases):
    """Largest error over reading, of a code in a hundred where the reading is below one."""
    worst = 0.0
    for g, row, uv, result in cases:
        reading = np.abs(result - predict(model, np.zeros_like(g), row, uv))
        error = np.abs(predict(model, g, row, uv) - result)
        worst = max(worst, np.max(np.maximum(error - 0.5, 0) / np.maximum(reading, 1)))
    return worst


def transfer(p):
    """Codes from volts of the columns and of the supply, by the output stage's two ends; the code at which it clips."""
    volts = np.linspace(0.24, 1.18, 11)
    pins = spice.chain(p, volts)
    slope, offset = np.polyfit(volts, pins, 1)
    require(np.max(abs(slope * volts + offset - pins)) * CODES_PER_V < 0.1, "the output stage is linear to 0.1 codes")
    va = spice.driven_row(p, [[0.0]], [LINES], [LINES], 0)[1]
    clip = spice.chain(p, np.array([0.1, 0.15]))[0] * CODES_PER_V
    return (lambda result: (slope * result[0] + offset * result[1] / va) * CODES_PER_V), float(clip)


def reduction(p):
    """One transition with all lines drawn against its classes of lines."""
    pattern = patterns()["a row and a column"]
    g, rows, cols, drive, take = spice.transition(pattern, 8 * LINES + 31)
    few = spice.scan_step(p, g, rows, cols, drive, take, stop_us=3.0)
    every = [(int(r == 8), int(r == 9)) for r in range(LINES)]
    ones = [1] * LINES
    all_lines = spice.scan_step(p, pattern, ones, ones, every, (31, 0), stop_us=3.0)
    time = np.linspace(0.1e-6, 2.9e-6, 500)
    off = abs(np.interp(time, few[:, 0], few[:, 1]) - np.interp(time, all_lines[:, 0], all_lines[:, 1])) * CODES_PER_V
    require(max(off) < 12 and max(off[time > 1e-6]) < 0.5, "classes of lines against 32 by 32 lines, a row change: "
            f"{max(off):.1f} codes apart on the edge, {max(off[time > 1e-6]):.2f} after 1 µs")


def rejected(full_scale):
    """The front end of the former wiring page fails, by these mechanisms."""
    count = 3.3 / 4096
    row = patterns()["a row"]
    g, rows, cols = spice.classes(row, [9], [4, 5])
    none = np.zeros_like(g).tolist()
    one_rail, idle = (former.step(x, rows, cols, negative_rail=False)[-1, 1] for x in (g, none))
    print(f"  one rail: a taxel at full scale reads {one_rail:.3f} V, an untouched one {idle:.3f} V: the sign")
    data = former.step(g, rows, cols, negative_rail=True)
    out = data[:, 1]
    off = abs(out[data[:, 0] * 1e9 < parameters()["scan"]["trigger_ns"]][-1] - out[-1]) / count
    print(f"  with a negative rail: {off:.0f} counts of 4096 off at the trigger after a column that was open; "
          f"its charge drives the virtual ground to {data[:, 2].max():.2f} V")
    others = patterns()["everything"]
    others[9, 5] = 0
    readings = []
    for pattern in (1 - others, others):
        g, rows, cols = spice.classes(pattern, [9], [4, 5])
        readings.append(former.step(g, rows, cols, negative_rail=True)[-1, 1])
    lost = readings[1] / readings[0]
    print(f"  static crosstalk: an untouched taxel reads {100 * lost:.0f} % of full scale where all others are pressed")
    slow_margins = {name: spice.phase_margin(parameters(amplifier__gbw_mhz=gbw, film__taxel_pf=0.0, film__line_pf=650.0,
            column__feedback_kohm=former.FEEDBACK_KOHM, column__feedback_pf=former.FEEDBACK_PF), "column")
            for name, gbw in (("10 MHz", 10.0), ("45 MHz", 45.0))}
    print("  phase margin of 4.7 kΩ, 22 pF at 650 pF: " + ", ".join(f"{m:.0f}° with {n}" for n, m in slow_margins.items()))
    require(one_rail - idle < 0.1 and off > 0.5 and lost > 0.005, "the former front end fails settling and crosstalk")
    print("variants of the new one")
    gates = parameters(row__on_ohm=16.0)
    of_row = crosstalk(gates, transfer(gates)[0], {"a row": row})["a row"] / full_scale
    print(f"  rows driven by gates of 16 Ω: {100 * of_row:.1f} % static crosstalk in a pressed row")
    slow = parameters(amplifier__gbw_mhz=10.0, amplifier__slew_v_us=5.0, film__taxel_pf=0.0, film__line_pf=500.0)
    data = spice.scan_step(slow, *spice.transition(row, 9 * LINES - 1))
    late = data[:, 0] * 1e9 < slow["scan"]["trigger_ns"]
    unsettled = abs(data[late][-1, 1] - data[-1, 1]) * CODES_PER_V / full_scale * 4096
    print(f"  columns' amplifiers of 10 MHz and 5 V/µs, 500 pF: {unsettled:.0f} counts of 4096 off at the trigger")
    require(of_row > 0.005 and unsettled > 0.5, "both variants fail")
    return {"open column": f"{off:,.0f} of 4,096 counts", "lost": f"{100 * lost:.0f} % static crosstalk",
            "margin": f"{min(slow_margins.values()):.0f}° of phase margin with 10 MHz", "gates": f"16 Ω: {100 * of_row:.1f} %",
            "slow": f"{unsettled:,.0f} counts off at the trigger"}


def page_figures(p, figures):
    """The wiring page's values are the parameters', its figures those of this run."""
    c, o = p["column"], p["output"]
    figures |= {
        "column": f"{c['feedback_kohm']} kΩ and {c['feedback_pf']} pF", "series": f"cable through {o['series_ohm']:.0f} Ω",
        "output": f"{o['feedback_kohm']} kΩ to {o['in_kohm']} kΩ", "pin": f"{o['pin_pf']:.0f} pF for the charge",
        "film": f"{1e3 / p['film']['full_scale_us']:.0f} kΩ ({p['film']['full_scale_us']:.0f} µS)",
        "taxel": f"at most {p['film']['taxel_pf']:.0f} pF", "line": f"at most {p['film']['line_ohm']} Ω",
        "pull-up": f"{o['pull_up_kohm']:.0f} kΩ to 3.3 V",
    }
    page = " ".join(WIRING.read_text().split())
    missing = [f"{name}: `{text}`" for name, text in figures.items() if text not in page]
    require(not missing, f"{len(figures)} values and figures of the wiring page" + "".join(f"; {m} is not on it" for m in missing))


def tables(model, cases):
    """The generator's constants, and samples of the simulation for its test."""
    text = "//! Made by `cargo xtask front-end --write` from the simulation of the front end: do not edit.\n"
    for name, (value, what) in model.items():
        text += f"\n/// {what}\npub const {name.upper()}: f64 = {float(f'{value:.5g}')!r};\n"
    samples = []
    for g, row, uv, result in cases:
        pressed = [[int(r), int(c), round(float(g[r, c]), 6)] for r, c in zip(*np.nonzero(g))]
        samples.append({"row": row, "offset_uv": [round(float(v), 2) for v in uv], "taxels": pressed,
                        "codes": [round(float(v), 2) for v in result]})
    return text, samples


def close(a, b, around_zero=0.0):
    """Numbers of the committed table and of this run: equal but for the last digits that another ngspice may change.
    Codes and microvolts of the samples go through zero."""
    if isinstance(a, dict):
        around = lambda k: 0.2 if k in ("codes", "offset_uv") else around_zero
        return isinstance(b, dict) and a.keys() == b.keys() and all(close(a[k], b[k], around(k)) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(close(x, y, around_zero) for x, y in zip(a, b))
    return abs(a - b) <= 1e-3 * max(abs(a), abs(b)) + around_zero


def main(out, write):
    p = parameters()
    out.mkdir(parents=True, exist_ok=True)
    os.chdir(out)  # SKiDL writes its logs where it is
    print("schematic")
    schematic_checks(out)
    print("transfer")
    codes, clip = transfer(p)
    fitted = fit(simulated(p, codes, 24, seed=1))
    idle, full_scale = fitted["idle"], fitted["full_scale"]
    tested = simulated(p, codes, 200, seed=2)
    share = off_share(fitted, tested)
    require(share < 0.01, f"model against simulation, 200 random patterns, {200 * LINES} taxels: {100 * share:.3f} % of reading")
    kpa = np.exp(np.linspace(np.log(1), np.log(FULL_SCALE_KPA), 40))
    curve = []
    for x in (kpa / FULL_SCALE_KPA) ** EXPONENT:
        g = np.zeros((LINES, LINES))
        g[3, 4] = x
        few, rows, cols = spice.classes(g, [3], [4])
        result = codes(spice.driven_row(p, few, rows, cols, 0))
        curve.append(abs(predict(fitted, g, 3, np.zeros(LINES))[4] - result[0]) / (result[0] - idle))
    require(max(curve) < 0.01, f"one taxel from 1 to {FULL_SCALE_KPA:.0f} kPa: {100 * max(curve):.3f} % of reading")
    require(idle + full_scale < clip, f"idle {idle:.0f}, 5 MPa {idle + full_scale:.0f}, clipped from {clip:.0f} of 65536 codes")
    print("static crosstalk, worst tolerances, no correction")
    leaks = crosstalk(p, codes, patterns())
    for name, error in leaks.items():
        require(error < 0.005 * full_scale, f"{name}: {100 * error / full_scale:.3f} % of full scale")
    print("stability")
    least_margin = margins()
    print("settling")
    reduction(p)
    settled_ns, residual, (low, high) = settling(full_scale / CODES_PER_V)
    noise = [spice.noise(p, load) * CODES_PER_V for load in (0, 8, 32)]
    adc = p["adc"]["noise_lsb"]
    square = np.polyfit((0, 8, 32), np.square(noise), 2)
    print(f"noise: {noise[0]:.1f} codes rms of the circuit, {np.hypot(noise[0], adc):.1f} with the ADC's {adc}; "
          f"{np.hypot(noise[2], adc):.1f} in a column of 32 taxels at full scale")
    print("the former front end")
    failing = rejected(full_scale)
    page_figures(p, failing | {
        "settled": f"after {settled_ns:,.0f} ns", "crosstalk": f"{100 * max(leaks.values()) / full_scale:.2f} % of full scale",
        "least margin": f"| {least_margin:.0f}° |", "swing": f"{low:.2f} V from ground; to {high:.2f} V",
        "noise": f"{np.hypot(noise[0], adc):.1f} of 65,536 codes", "model": f"{100 * share:.3f} % of the reading",
        "codes": f"at 5 MPa is {idle + full_scale:,.0f}, at rest {idle:,.0f}; the output ends at {clip:,.0f}",
    })
    print("tables")
    model = {
        "idle": (idle, "Code of an untouched taxel."),
        "full_scale": (full_scale, "Codes above idle of a lone taxel at 5 MPa."),
        "row_drop": (fitted["row_drop"], "Drop of the row's drive, share per taxel of the row at full scale."),
        "col_drop": (fitted["col_drop"], "The same of its column."),
        "offset_per_uv": (fitted["offset_per_uv"], "Codes per µV of offset of the column's amplifier."),
        "leak_per_uv": (fitted["leak_per_uv"], "Codes per µV more for each taxel of the column at full scale."),
        "noise": (float(np.hypot(noise[0], adc)), "Noise of an idle column and of the ADC, codes rms."),
        "noise_per_load": (square[1], "Variance of it, codes², for each taxel of the column at full scale."),
        "noise_per_load2": (square[0], "The same for the square of their number."),
        "clip": (clip, "Code at which the output stage ends."),
        "residual": (residual, "Largest error of settling, codes: of a step from full scale to idle and other transitions."),
    }
    text, samples = tables(model, tested[:6])
    if write:
        TABLE.write_text(text)
        CASES.write_text(json.dumps(samples) + "\n")
    numbers = lambda source: {name: float(value) for name, value in re.findall(r"const (\w+): f64 = ([-\d.e]+);", source)}
    require(close(numbers(TABLE.read_text()), numbers(text)), "the generator's constants are those of this run")
    require(close(json.loads(CASES.read_text()), samples), "the samples of its test are those of this run")
    scan = {name: int(value) for name, value in re.findall(
        r"pub const (\w+_NS): u32 = ([\d_]+);", (ROOT / "src/drivers/scan.rs").read_text())}
    require(scan.get("DMA_NS") == p["scan"]["dma_ns"] and settled_ns <= scan.get("ANALOG_NS", 0) <= settled_ns + 100,
            f"the scan's constants leave {scan.get('ANALOG_NS')} ns for the {settled_ns:.0f} ns of the circuit")
    print(f"{len(failures)} requirements missed")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve(), "--write" in sys.argv))
