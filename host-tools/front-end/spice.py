"""Netlists of the front end for ngspice, and their results.

The array is drawn by classes of lines: rows that see the same pressures and the same drive are one row of m times the
conductance, capacitance and drive; columns likewise, with m amplifiers in parallel. By symmetry this is exact; `check.py`
compares it with all 32 by 32 lines.
"""

import os
import subprocess
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
LINES = 32


def parameters(**changes):
    """Values by section; `changes` as `section__name=value` for corners and for other circuits."""
    values = tomllib.loads((HERE / "parameters.toml").read_text())
    for name, value in changes.items():
        section, key = name.split("__")
        assert key in values[section], name
        values[section][key] = value
    return values


def ngspice(netlist, results):
    """Runs a netlist; `results` are expressions. Their vectors over the axis of the analysis, as columns."""
    with tempfile.TemporaryDirectory() as folder:
        listing = f"{netlist}\n.options reltol=1e-5 abstol=1e-13 vntol=1e-8\n.control\nset wr_singlescale\nset noaskquit\n"
        listing += f"run\nwrdata out.data {' '.join(results)}\nquit\n.endc\n.end\n"
        (Path(folder) / "in.cir").write_text("front end\n" + listing)
        run = subprocess.run(["ngspice", "-b", "in.cir"], cwd=folder, capture_output=True, text=True)
        out = Path(folder) / "out.data"
        if not out.exists() or "singular" in run.stderr:
            raise RuntimeError(f"ngspice: {run.stdout[-2000:]}{run.stderr[-2000:]}")
        return np.loadtxt(out, ndmin=2)


def together(function, items):
    """`function` of all items, one ngspice per core at a time."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, items))


def op_amp(p):
    """Behaviour of one amplifier: offset, bias, one pole with slew limit, swing, second pole, output resistance, noise.
    `m`: that many in parallel."""
    a, vmax = p["amplifier"], p["supply"]["va_v"] - p["amplifier"]["swing_v"]
    rate = 2 * np.pi * a["gbw_mhz"]  # per µs
    return f"""
.subckt opamp plus minus out m=1 vos=0
Ibp 0 plus {{m*{a['bias_ua']}u}}
Ibm 0 minus {{m*{a['bias_ua']}u}}
Cp plus 0 {{m*{a['input_pf']}p}}
Cm minus 0 {{m*{a['input_pf']}p}}
Rn1 n1 0 {a['noise_nv'] ** 2 * 1e-18 / 1.6568e-20}
Rn2 n2 0 1k
Gn 0 minus n2 0 {{sqrt(m)*{a['noise_pa'] * 1e-12 / 4.0704e-9}}}
Ev d 0 vol='V(plus)-V(minus)+vos+V(n1)/sqrt(m)'
Bs 0 x I={a['slew_v_us']}*tanh({rate / a['slew_v_us']}*V(d))
Cx x 0 1u
Rx x 0 {a['open_loop'] / rate}
Bh x 0 I=1e6*(max(V(x)-{vmax},0)-max({a['swing_v']}-V(x),0))
Ex y 0 x 0 1
Ry y z 1
Cz z 0 {{1/(6.2832*{a['second_pole_mhz']}e6)}}
Ez w 0 z 0 1
Ro w out {{{a['out_ohm']}/m}}
.ends
"""


def common(p):
    """The supply and the virtual ground that all columns share."""
    s, c = p["supply"], p["common"]
    return f"""
Vdd vdd 0 {s['va_v']}
Rfeed vdd va {s['feed_ohm']}
Cva va vae {s['bulk_uf']}u
Rvae vae 0 5m
Rct va cdiv {c['top_kohm']}k
Rcb cdiv 0 {c['bottom_kohm']}k
Ccd cdiv 0 10u
Xc cdiv cfb cout opamp
Rci cout vcm {c['isolation_ohm']}
Rcf vcm cfb {c['feedback_kohm']}k
Ccf cout cfb {c['feedback_nf']}n
Cvcm vcm vcme {c['bulk_uf']}u
Rvcme vcme 0 5m
"""


def array(p, g, rows, cols, drive, vos=None):
    """Rows `rows[i]` times, columns `cols[j]` times, conductances `g[i][j]` relative to full scale. `drive[i]` is the
    name of a voltage, 0 to 1, that says how far the row is on its way from the common voltage to the supply."""
    f, r, c = p["film"], p["row"], p["column"]
    lines = []
    for i, m in enumerate(rows):
        # No overlap: the charge of both being on is a source of its own.
        on = f"max(2*V({drive[i]})-1,0)"
        lines += [
            f"Bd{i} va r{i} I={m / r['on_ohm']}*{on}*(V(va)-V(r{i}))",
            f"Bh{i} vcm r{i} I={m / r['hold_ohm']}*max(1-2*V({drive[i]}),1e-9)*(V(vcm)-V(r{i}))",
            f"Rr{i} r{i} rl{i} {f['line_ohm'] / m}",
            f"Cr{i} rl{i} 0 {m * f['line_pf']}p",
        ]
    for j, n in enumerate(cols):
        lines += [
            f"Cc{j} c{j} 0 {n * f['line_pf']}p",
            f"Rc{j} c{j} s{j} {f['line_ohm'] / n}",
            f"Rf{j} s{j} o{j} {c['feedback_kohm'] / n}k",
            f"Cf{j} s{j} o{j} {n * c['feedback_pf']}p",
            f"Xa{j} vcm s{j} o{j} opamp m={n} vos={0 if vos is None else vos[j]}",
        ]
        for i, m in enumerate(rows):
            lines.append(f"Ct{i}_{j} rl{i} c{j} {m * n * f['taxel_pf']}p")
            if g[i][j] > 0:
                lines.append(f"Rt{i}_{j} rl{i} c{j} {1e6 / (m * n * g[i][j] * f['full_scale_us'])}")
    return "\n".join(lines)


def output(p):
    """From the multiplexer's drain to the ADC's sampling capacitor."""
    o, a = p["output"], p["adc"]
    return f"""
Rot va odiv {o['top_kohm']}k
Rob odiv 0 {o['bottom_kohm']}k
Cod odiv 0 1u
Ro1 mux oin {o['in_kohm']}k
Ro2 oin oout {o['feedback_kohm']}k
Co2 oin oout {o['feedback_pf']}p
Xo odiv oin oout opamp
Rs oout line {o['series_ohm']}
Cl line 0 {o['cable_pf']}p
Rl line pin 0.1
Cp pin 0 {o['pin_pf']}p
Rp vdd pin {o['pull_up_kohm']}k
Rad pin hold {a['switch_ohm']}
"""


def scan_step(p, g, rows, cols, drive, take, stop_us=9.0):
    """One change of address, at the pins after the DMA's delay. `drive[i]`: (before, after) of row class i, 0 or 1;
    `take`: index of the column before and after. Voltage at the ADC's pin over time, and of its capacitor."""
    r, mx, a, sc = p["row"], p["mux"], p["adc"], p["scan"]
    at = sc["dma_ns"]
    pwl = lambda before, after, delay, edge: (
        f"PWL(0 {before} {at + delay}n {before} {at + delay + edge}n {after} 1 {after})"
    )
    lines = [op_amp(p), common(p), output(p)]
    lines.append(array(p, g, rows, cols, [f"d{i}" for i in range(len(rows))]))
    for i, (before, after) in enumerate(drive):
        lines.append(f"Vd{i} d{i} 0 {pwl(before, after, r['delay_ns'], r['edge_ns'])}")
    if any(before != after for before, after in drive):
        lines.append(
            f"Ist va vcm PULSE(0 {r['shoot_through_a']} {at + r['delay_ns']}n 0.1n 0.1n {r['shoot_through_ns']}n 1)"
        )
    for k, (column, before, after, delay) in enumerate(
        [(take[0], 1, 0, mx["delay_ns"] - mx["open_ns"]), (take[1], 0, 1, mx["delay_ns"])]
    ):
        assert cols[column] == 1
        lines += [
            f"Vm{k} m{k} 0 {pwl(before, after, delay, 2)}",
            f"Ri{k} o{column} q{k} {p['column']['isolation_ohm']}",
            f"Cq{k} q{k} 0 {mx['source_pf']}p",
            f"Bm{k} q{k} mux I=V(m{k})/{mx['on_ohm']}*(V(q{k})-V(mux))",
        ]
    lines += [
        f"Cmux mux 0 {mx['drain_pf']}p",
        f"Iq 0 mux PULSE(0 {mx['charge_pc'] * 1e-3} {at + mx['delay_ns']}n 0.1n 0.1n 0.9n 1)",
        # The sampling capacitor comes from the opposite end of the range.
        f"Vs sw 0 PULSE(0 1 {sc['trigger_ns']}n 1n 1n {a['sampling_ns']}n 1)",
        "Bs hold cs I=V(sw)*1e-1*(V(hold)-V(cs))",
        f"Cs cs 0 {a['sample_pf']}p",
        f"Bpre 0 cs I=(1-V(sw))*1e-2*({p['supply']['va_v']}-V(cs))",
        f".tran 5n {stop_us}u 0 5n",
    ]
    return ngspice("\n".join(lines), ["v(pin)", "v(cs)", "v(o0)", "v(oout)"])


def classes(pattern, rows, cols):
    """A 32 by 32 pattern as classes of equal lines; the lines named in `rows` and `cols` are classes of one line, first
    and in this order. Conductances, multiplicities of rows and of columns."""
    def group(matrix, single):
        groups = [[i] for i in single]
        kinds = {}
        for i in range(LINES):
            if i not in single:
                kinds.setdefault(tuple(matrix[i]), []).append(i)
        return groups + list(kinds.values())

    # Rows are alike where they see the same pressures.
    by_row, by_col = group(pattern, rows), group(pattern.T, cols)
    g = [[pattern[i[0], j[0]] for j in by_col] for i in by_row]
    return g, [len(i) for i in by_row], [len(j) for j in by_col]


def transition(pattern, slot):
    """From the taxel of `slot` to the next, in the whole pattern."""
    after = (slot + 1) % LINES**2
    (r0, c0), (r1, c1) = divmod(slot, LINES), divmod(after, LINES)
    singles = list(dict.fromkeys([r0, r1]))
    g, rows, cols = classes(pattern, singles, [c0, c1])
    drive = [(int(r == r0), int(r == r1)) for r in singles] + [(0, 0)] * (len(rows) - len(singles))
    return g, rows, cols, drive, (0, 1)


def phase_margin(p, stage, load=0.0):
    """Least distance of the loop gain's phase from −180° at its crossings of 1, degrees, of the amplifier of a `stage`:
    "column" whose taxels together conduct `load` of full scale, "common" or "output". The loop is opened inside the
    amplifier, for alternating voltages only."""
    model = op_amp(p)
    opened = model.replace("subckt opamp", "subckt opened").replace(
        "Ev d 0 vol='V(plus)-V(minus)+vos+V(n1)/sqrt(m)'",
        "Ee e 0 vol='V(plus)-V(minus)+vos'\nRe e f 1k\nCe f 0 1meg\nVac d f AC 1",
    )
    lines = [model, opened, common(p), "Vd d 0 0", output(p)]
    lines.append(array(p, [[load / LINES]], [LINES], [1], ["d"]))
    lines += [f"Ri o0 q {p['column']['isolation_ohm']}", f"Cq q 0 {p['mux']['source_pf']}p"]
    lines += [f"Rm q mux {p['mux']['on_ohm']}", f"Cmux mux 0 {p['mux']['drain_pf']}p"]
    name = {"column": "Xa0", "common": "Xc", "output": "Xo"}[stage]
    netlist = "\n".join(lines).replace(f"\n{name} ", f"\n{name}@ ").split("\n")
    netlist = [line.replace("@", "").replace("opamp", "opened") if "@" in line else line for line in netlist]
    netlist.append(".ac dec 100 1 1g")
    test = f"v({name.lower()}.e)"
    data = ngspice("\n".join(netlist), [f"real({test})", f"imag({test})"])
    gain = -(data[:, 1] + 1j * data[:, 2])
    phase = np.unwrap(np.angle(gain))
    crossings = np.flatnonzero((abs(gain[:-1]) >= 1) & (abs(gain[1:]) < 1))
    return 180 + np.degrees(phase[crossings].min())


def noise(p, load):
    """V rms at the ADC's pin, of a column whose idle rows' taxels together conduct `load` of full scale."""
    lines = [op_amp(p), common(p), output(p), "Vd d 0 0 AC 1"]
    lines.append(array(p, [[load / LINES]], [LINES], [1], ["d"]))
    lines += [f"Ri o0 q {p['column']['isolation_ohm']}", f"Rm q mux {p['mux']['on_ohm']}"]
    lines += [f"Cmux mux 0 {p['mux']['drain_pf']}p", ".noise v(pin) Vd dec 50 10 1g"]
    return float(ngspice("\n".join(lines), ["onoise_total"]).ravel()[-1])


def driven_row(p, g, rows, cols, row, vos=None):
    """Volts at the outputs of the column amplifiers by class, row class `row` driven; then of the supply, on which the
    output stage's reference hangs."""
    drive = ["one" if i == row else "none" for i in range(len(rows))]
    lines = [op_amp(p), common(p), "Vone one 0 1", "Vnone none 0 0", array(p, g, rows, cols, drive, vos)]
    data = ngspice("\n".join(lines + [".op"]), [*(f"v(o{j})" for j in range(len(cols))), "v(va)"])
    return data[0, 1:-1], data[0, -1]


def chain(p, volts):
    """Volts at the ADC's pin for volts of a column amplifier: ascending, evenly spaced."""
    lines = [op_amp(p), common(p), output(p), f"Vx o0 0 {volts[0]}"]
    lines.append(f"Ri o0 mux {p['column']['isolation_ohm'] + p['mux']['on_ohm']}")
    lines.append(f".dc Vx {volts[0]} {volts[-1] + 1e-9} {volts[1] - volts[0]}")
    return ngspice("\n".join(lines), ["v(pin)"])[:, 1]
