"""The front end that this one replaces, as the wiring page drew it: rows push-pull between 0 and 3.3 V, columns open until
one multiplexer puts them on one transimpedance amplifier. Its amplifier had no name; here it is the new one's."""

from spice import LINES, ngspice, op_amp, parameters

DRIVER_OHM, FEEDBACK_KOHM, FEEDBACK_PF, LINE_PF = 100.0, 4.7, 22.0, 500.0


def step(g, rows, cols, negative_rail):
    """One change of address, from column class 0 to 1, row class 0 driven. Volts of the amplifier over time. With a
    negative rail its output may go where its sign points."""
    p = parameters(film__full_scale_us=1e3 / FEEDBACK_KOHM)  # 3.3 V is 3.3 V
    model = op_amp(p)
    if negative_rail:
        model = model.replace(f"{p['amplifier']['swing_v']}-V(x)", "-5-V(x)")
    at = p["scan"]["dma_ns"] + 100
    lines = [model, "Vdd va 0 3.3"]
    for i, m in enumerate(rows):
        lines += [f"Vr{i} d{i} 0 {3.3 if i == 0 else 0}"]
        lines += [f"Rr{i} d{i} r{i} {DRIVER_OHM / m}", f"Cr{i} r{i} 0 {m * p['film']['line_pf']}p"]
    for j, n in enumerate(cols):
        lines += [f"Cc{j} c{j} 0 {n * LINE_PF}p", f"Rc{j} c{j} 0 100g"]
        for i, m in enumerate(rows):
            if g[i][j] > 0:
                lines.append(f"Rt{i}_{j} r{i} c{j} {1e6 / (m * n * g[i][j] * p['film']['full_scale_us'])}")
    for k, (column, before, after, late) in enumerate([(0, 1, 0, 0), (1, 0, 1, 10)]):
        lines.append(f"Vm{k} m{k} 0 PWL(0 {before} {at + late}n {before} {at + late + 2}n {after} 1 {after})")
        lines.append(f"Bm{k} c{column} sum I=max(V(m{k}),1e-10)/{p['mux']['on_ohm']}*(V(c{column})-V(sum))")
    lines += [f"Cd sum 0 {p['mux']['drain_pf']}p", f"Rf sum out {FEEDBACK_KOHM}k", f"Cf sum out {FEEDBACK_PF}p"]
    lines += ["Xa 0 sum out opamp", ".tran 5n 12.0u 0 5n"]
    return ngspice("\n".join(lines), ["v(out)", "v(sum)"])
