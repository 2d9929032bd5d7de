"""Schematic of one fingertip and of the adapter on the NUCLEO board, as code: electrical rules, netlists, bills of materials.

Values come from `parameters.toml`. Symbols are KiCad's; the two parts that it lacks are below, pins by their data sheets.
"""

import builtins
import csv
import os
import re
from collections import defaultdict

SYMBOLS = "/usr/share/kicad/symbols"
for version in ("", *range(6, 11)):
    os.environ.setdefault(f"KICAD{version}_SYMBOL_DIR", SYMBOLS)

import skidl  # noqa: E402  reads the variables above
from skidl import KICAD6, POWER, Net, Part, Pin, TEMPLATE  # noqa: E402

from spice import LINES, parameters  # noqa: E402

skidl.set_default_tool(KICAD6)
skidl.lib_search_paths[KICAD6] = [SYMBOLS]

ADDRESS = [f"COL_A{i}" for i in range(5)] + [f"ROW_A{i}" for i in range(5)]
# The cable: 26 wires, Samtec FFSD-13-D-12.00-01-N, contacts in order. Ground beside the reading and the clock.
CABLE = ["3V3", "3V3", "GND", "AOUT", "GND", *ADDRESS[:5], "GND", *ADDRESS[5:]]
CABLE += ["GND", "SCK", "GND", "MOSI", "MISO", "CS", "GND", "GND", "3V3", "GND"]
FINGERS = 3
# Pins of the board, by signal; `check.py` compares them with the firmware and the wiring page.
BOARD = dict(zip(ADDRESS, [f"PE{i}" for i in range(2, 12)]))
BOARD |= {"AOUT0": "PA3", "AOUT1": "PC0", "AOUT2": "PB1", "SCK": "PA5", "MOSI": "PB5", "MISO": "PA6"}
BOARD |= {"CS0": "PD14", "CS1": "PD15", "CS2": "PG12", "CAN_RX": "PD0", "CAN_TX": "PD1"}

# Maker and full order code of a passive part by kind and value. 0.1 % where a ratio makes the reading.
ORDER = {
    ("R", "18.2k"): ("Panasonic", "ERA-2AEB1822X"),
    ("R", "15.4k"): ("Panasonic", "ERA-2AEB1542X"),
    ("R", "4.99k"): ("Panasonic", "ERA-2AEB4991X"),
    ("R", "10k"): ("Panasonic", "ERA-2AEB103X"),
    ("R", "5.76k"): ("Panasonic", "ERA-2AEB5761X"),
    ("R", "3.92k"): ("Panasonic", "ERA-2AEB3921X"),
    ("R", "1k"): ("Yageo", "RC0402FR-071KL"),
    ("R", "100k"): ("Yageo", "RC0402FR-07100KL"),
    ("R", "100"): ("Yageo", "RC0402FR-07100RL"),
    ("R", "120"): ("Yageo", "RC0805FR-07120RL"),
    ("R", "47"): ("Yageo", "RC0402FR-0747RL"),
    ("R", "4.7"): ("Yageo", "RC0402FR-074R7L"),
    ("C", "8.2p"): ("Murata", "GJM1555C1H8R2CB01D"),
    ("C", "5.6p"): ("Murata", "GJM1555C1H5R6CB01D"),
    ("C", "470p"): ("Murata", "GRM1555C1H471JA01D"),
    ("C", "10n"): ("Murata", "GRM155R71H103KA88D"),
    ("C", "100n"): ("Murata", "GRM155R71C104KA88D"),
    ("C", "1u"): ("Murata", "GRM155R61A105KE15D"),
    ("C", "10u"): ("Murata", "GRM188R61A106KE69D"),
    ("C", "22u"): ("Murata", "GRM21BR60J226ME39L"),
    ("FerriteBead", "120R@100M"): ("Murata", "BLM18KG121TN1D"),
}
# Footprint by symbol; capacitors from 10 µF on are larger.
FOOTPRINT = {
    "R": "Resistor_SMD:R_0402_1005Metric",
    "C": "Capacitor_SMD:C_0402_1005Metric",
    "FerriteBead": "Inductor_SMD:L_0603_1608Metric",
    "ADA4807-4": "Package_SO:TSSOP-14_4.4x5mm_P0.65mm",
    "ADA4807-2ARM": "Package_SO:MSOP-8_3x3mm_P0.65mm",
    "ADG732": "Package_QFP:TQFP-48_7x7mm_P0.5mm",
    "DMC2400UV": "Package_TO_SOT_SMD:SOT-563",
    "74LS138": "Package_SO:TSSOP-16_4.4x5mm_P0.65mm",
    "74LVC1G04": "Package_TO_SOT_SMD:SOT-353_SC-70-5",
    "TPD4E02B04DQA": "Package_SON:USON-10_2.5x1.0mm_P0.5mm",
    "TJA1042T-3": "Package_SO:SOIC-8_3.9x4.9mm_P1.27mm",
    "NUCLEO144-H743ZI": "Module:ST_Morpho_Connector_144_STLink",
    "Conn_01x03": "TerminalBlock_Phoenix:TerminalBlock_Phoenix_PT-1,5-3-3.5-H_1x03_P3.50mm_Horizontal",
    "Conn_01x06": "Connector_PinHeader_1.27mm:PinHeader_1x06_P1.27mm_Vertical",
    "Conn_02x13_Odd_Even": "Connector_PinHeader_1.27mm:PinHeader_2x13_P1.27mm_Vertical_SMD",
    "Conn_01x40": "Connector_FFC-FPC:Hirose_FH12-40S-0.5SH_1x40-1MP_P0.50mm_Horizontal",
    "10u": "Capacitor_SMD:C_0603_1608Metric",
    "22u": "Capacitor_SMD:C_0805_2012Metric",
}


def own_part(name, pins):
    """A symbol that KiCad does not have: (number, name, function)."""
    part = Part(name=name, tool=skidl.SKIDL, dest=TEMPLATE, ref_prefix="U", tag=name)
    part.add_pins(*[Pin(num=str(n), name=pin, func=getattr(skidl.pin.pin_types, kind)) for n, pin, kind in pins])
    return part


def mux():
    """ADG732, 48-lead TQFP."""
    pins = [(i, f"S{13 - i}", "PASSIVE") for i in range(1, 13)]
    pins += [(i, f"S{i - 8}", "PASSIVE") for i in range(25, 41)]
    pins += [(i, f"S{61 - i}", "PASSIVE") for i in range(45, 49)]
    pins += [(15 + i, f"A{i}", "INPUT") for i in range(5)]
    pins += [(20, "~CS", "INPUT"), (21, "~WR", "INPUT"), (22, "~EN", "INPUT"), (43, "D", "PASSIVE")]
    pins += [(13, "VDD1", "PWRIN"), (14, "VDD2", "PWRIN"), (23, "GND", "PWRIN"), (24, "VSS", "PWRIN")]
    return own_part("ADG732", pins + [(i, f"NC{i}", "NOCONNECT") for i in (41, 42, 44)])


def pair():
    """DMC2400UV, SOT-563: 1 is the N channel, 2 the P channel."""
    pins = [(1, "S1", "PASSIVE"), (2, "G1", "INPUT"), (3, "D2", "PASSIVE")]
    return own_part("DMC2400UV", pins + [(4, "S2", "PASSIVE"), (5, "G2", "INPUT"), (6, "D1", "PASSIVE")])


def join(part, name, net):
    """The one pin of this name on a net."""
    [pin] = [pin for pin in part.pins if pin.name == name]
    pin += net


def wire(part, nets, pins=range(1, 41)):
    """Pins of these numbers to nets, in order."""
    for pin, net in zip(pins, nets):
        part[pin] += net


class Sheet:
    """One board: its parts with order codes."""

    def __init__(self):
        skidl.reset()
        self.gnd, self.bom, self.count = Net("GND"), defaultdict(list), 0
        self.gnd.drive = POWER

    def part(self, library, name, maker, code, template=None):
        self.count += 1
        tag = str(self.count)
        part = template(1, tag=tag)[0] if template else Part(library, name, tag=tag)
        part.value, part.footprint = code, FOOTPRINT[part.name]
        self.bom[(maker, code)].append(part)
        return part

    def passive(self, kind, value, a, b):
        maker, code = ORDER[(kind, value)]
        part = self.part("Device", kind, maker, code)
        part.value = value
        part.footprint = FOOTPRINT.get(value, part.footprint)
        wire(part, (a, b))

    def r(self, ohm, a, b):
        self.passive("R", f"{ohm / 1e3:g}k" if ohm >= 1e3 else f"{ohm:g}", a, b)

    def c(self, pf, a, b):
        scale = next((s for s in ((1e6, "u"), (1e3, "n")) if pf >= s[0]), (1, "p"))
        self.passive("C", f"{pf / scale[0]:g}{scale[1]}", a, b)

    def power(self, part, vcc, *pins):
        """Supply and ground pins, and 100 nF beside them."""
        join(part, pins[0], vcc)
        join(part, pins[1], self.gnd)
        self.c(100e3, vcc, self.gnd)

    def amplifiers(self, quads, vcc, name, code):
        """(+, −, output) pins of as many parts."""
        units = {"ADA4807-4": [(3, 2, 1), (5, 6, 7), (10, 9, 8), (12, 13, 14)], "ADA4807-2ARM": [(3, 2, 1), (5, 6, 7)]}
        out = []
        for _ in range(quads):
            part = self.part("Amplifier_Operational", name, "Analog Devices", code)
            self.power(part, vcc, "V+", "V-")
            out += [(part[p], part[m], part[o]) for p, m, o in units[name]]
        return out

    def finish(self, folder, name):
        """Rules, netlist and bill of materials. Errors and warnings of the rules."""
        skidl.ERC()
        counts = (skidl.erc_logger.error.count, skidl.erc_logger.warning.count)
        skidl.generate_netlist(file_=str(folder / f"{name}.net"), tool=KICAD6)
        with open(folder / f"{name}.bom.csv", "w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["quantity", "maker", "order code", "value", "references"])
            for (maker, code), parts in sorted(self.bom.items()):
                references = sorted((part.ref for part in parts), key=lambda r: (r[0], int(re.sub(r"\D", "", r))))
                table.writerow([len(parts), maker, code, parts[0].value, " ".join(references)])
        return counts


def fingertip(p):
    """Row drivers, array connectors, 32 column amplifiers, multiplexer, reference, cable driver."""
    s = Sheet()
    gnd, va, vcm = s.gnd, Net("VA"), Net("VCM")
    cable = {name: Net(name) for name in dict.fromkeys(CABLE) if name != "GND"} | {"GND": gnd}
    va.drive = POWER
    connector = s.part("Connector_Generic", "Conn_02x13_Odd_Even", "Samtec", "FTSH-113-01-L-DV-K")
    wire(connector, [cable[name] for name in CABLE])
    protected = [n for n in cable if n not in ("GND", "3V3")]
    for i in range(0, len(protected), 4):
        esd = s.part("Power_Protection", "TPD4E02B04DQA", "Texas Instruments", "TPD4E02B04DQAR")
        nets = [cable[name] for name in protected[i : i + 4]]
        wire(esd, [gnd, gnd, *nets, *[builtins.NC] * 4], (3, 8, 1, 2, 4, 5))
    s.passive("FerriteBead", "120R@100M", cable["3V3"], va)
    s.c(p["supply"]["bulk_uf"] * 1e6, va, gnd)

    # Rows: the decoder's low output selects; P to the supply, else N to the common voltage.
    rows = [Net(f"ROW{i}") for i in range(LINES)]
    a3, a4, not_a3 = cable["ROW_A3"], cable["ROW_A4"], Net("NOT_ROW_A3")
    inverter = s.part("74xGxx", "74LVC1G04", "Nexperia", "74LVC1G04GW,125")
    s.power(inverter, va, "VCC", "GND")
    wire(inverter, (a3, not_a3), (2, 4))
    template = pair()
    for block, (low1, low2, high) in enumerate([(a3, a4, va), (not_a3, a4, va), (a3, gnd, a4), (not_a3, gnd, a4)]):
        decoder = s.part("74xx", "74LS138", "Nexperia", "74LVC138APW,118")
        s.power(decoder, va, "VCC", "GND")
        for pin, net in zip(("A0", "A1", "A2", "E1", "E2", "E3"), (*[cable[f"ROW_A{i}"] for i in range(3)], low1, low2, high)):
            join(decoder, pin, net)
        for i in range(8):
            gate = Net(f"GATE{8 * block + i}")
            join(decoder, f"O{i}", gate)
            fets = s.part(None, None, "Diodes", "DMC2400UV-7", template)
            wire(fets, (vcm, gate, rows[8 * block + i], va, gate, rows[8 * block + i]))

    # Columns.
    columns = [Net(f"COL{i}") for i in range(LINES)]
    multiplexer = s.part(None, None, "Analog Devices", "ADG732BSUZ", mux())
    s.power(multiplexer, va, "VDD1", "GND")
    join(multiplexer, "VDD2", va)
    for pin in ("VSS", "~CS", "~WR", "~EN"):
        join(multiplexer, pin, gnd)
    for i in range(5):
        join(multiplexer, f"A{i}", cable[f"COL_A{i}"])
    k = p["column"]
    for i, (plus, minus, out) in enumerate(s.amplifiers(LINES // 4, va, "ADA4807-4", "ADA4807-4ARUZ")):
        plus += vcm
        minus += columns[i]
        tia, source = Net(f"TIA{i}"), Net(f"MUX{i}")
        out += tia
        s.r(k["feedback_kohm"] * 1e3, columns[i], tia)
        s.c(k["feedback_pf"], columns[i], tia)
        s.r(k["isolation_ohm"], tia, source)
        join(multiplexer, f"S{i + 1}", source)

    for name, lines in (("row", rows), ("column", columns)):
        array = s.part("Connector_Generic", "Conn_01x40", "Hirose", "FH12-40S-0.5SH(55)")
        wire(array, [gnd] * 4 + lines + [gnd] * 4)

    # Common voltage and cable driver: one dual amplifier.
    (cp, cm, co), (op, om, oo) = s.amplifiers(1, va, "ADA4807-2ARM", "ADA4807-2ARMZ")
    c, o = p["common"], p["output"]
    divider, feedback, buffer = Net("VCM_DIV"), Net("VCM_FB"), Net("VCM_BUF")
    s.r(c["top_kohm"] * 1e3, va, divider)
    s.r(c["bottom_kohm"] * 1e3, divider, gnd)
    s.c(10e6, divider, gnd)
    cp += divider
    cm += feedback
    co += buffer
    s.r(c["isolation_ohm"], buffer, vcm)
    s.r(c["feedback_kohm"] * 1e3, vcm, feedback)
    s.c(c["feedback_nf"] * 1e3, buffer, feedback)
    for _ in range(2):
        s.c(c["bulk_uf"] / 2 * 1e6, vcm, gnd)
    divider, feedback, drain, driver = Net("OUT_DIV"), Net("OUT_FB"), Net("MUX_D"), Net("OUT")
    join(multiplexer, "D", drain)
    s.r(o["top_kohm"] * 1e3, va, divider)
    s.r(o["bottom_kohm"] * 1e3, divider, gnd)
    s.c(1e6, divider, gnd)
    op += divider
    om += feedback
    oo += driver
    s.r(o["in_kohm"] * 1e3, drain, feedback)
    s.r(o["feedback_kohm"] * 1e3, feedback, driver)
    s.c(o["feedback_pf"], feedback, driver)
    s.r(o["series_ohm"], driver, cable["AOUT"])

    # The accelerometer sits on a board of its own, as its maker sells it.
    breakout = s.part("Connector_Generic", "Conn_01x06", "Harwin", "M50-3130645")
    wire(breakout, [cable[name] for name in ("3V3", "GND", "SCK", "MOSI", "MISO", "CS")])
    return s


def adapter(p):
    """On the NUCLEO board's pin headers: three fingers and the bus."""
    s = Sheet()
    board = s.part("MCU_Module", "NUCLEO144-H743ZI", "STMicroelectronics", "NUCLEO-H743ZI2")
    v33, v5 = Net("3V3"), Net("5V")
    v33.drive = v5.drive = POWER
    signals = {}
    for pin in board.pins:
        used = next((signal for signal, name in BOARD.items() if name in pin.name.split("/")), None)
        if used:
            signals[used] = Net(used)
            pin += signals[used]
        elif pin.name in ("GND", "AGND"):
            pin += s.gnd
        elif pin.name in ("+3V3", "+5V"):
            pin += {"+3V3": v33, "+5V": v5}[pin.name]
        else:
            pin += builtins.NC
    assert len(signals) == len(BOARD)
    for finger in range(FINGERS):
        connector = s.part("Connector_Generic", "Conn_02x13_Odd_Even", "Samtec", "FTSH-113-01-L-DV-K")
        for i, name in enumerate(CABLE):
            if name in ("GND", "3V3"):
                connector[i + 1] += {"GND": s.gnd, "3V3": v33}[name]
                continue
            net = signals[f"{name}{finger}" if name in ("AOUT", "CS") else name]
            if name in ("AOUT", "MISO"):
                connector[i + 1] += net
            else:
                # Ends the line at its source, one for each cable.
                branch = Net(f"F{finger}_{name}")
                s.r(47, net, branch)
                connector[i + 1] += branch
        s.r(p["output"]["pull_up_kohm"] * 1e3, v33, signals[f"AOUT{finger}"])
        s.c(p["output"]["pin_pf"], signals[f"AOUT{finger}"], s.gnd)
        s.c(p["supply"]["bulk_uf"] * 1e6, v33, s.gnd)
    can = s.part("Interface_CAN_LIN", "TJA1042T-3", "Texas Instruments", "TCAN1462VDRQ1")
    high, low = Net("CANH"), Net("CANL")
    wire(can, (signals["CAN_TX"], signals["CAN_RX"], v33, s.gnd, high, low), (1, 4, 5, 8, 7, 6))
    s.power(can, v5, "VCC", "GND")
    s.c(100e3, v33, s.gnd)
    s.r(120, high, low)
    bus = s.part("Connector_Generic", "Conn_01x03", "Phoenix Contact", "1935174")
    wire(bus, (high, low, s.gnd))
    return s, board


def write(folder):
    """Both boards into `folder`. Errors and warnings of each, and what each pin of the NUCLEO board reaches on a cable:
    {pin: {"finger 0 AOUT", ...}}."""
    p = parameters()
    rules = {"fingertip": fingertip(p).finish(folder, "fingertip")}
    sheet, board = adapter(p)
    reaches = defaultdict(set)
    series = sheet.bom[ORDER[("R", "47")]]
    for pin in board.pins:
        if not pin.net or pin.net.name in ("GND", "3V3", "5V") or pin.is_connected() is False:
            continue
        nets = {pin.net.name}
        nets |= {part[2].net.name for part in series if part[1].net.name in nets}
        name = next((n for n in pin.name.split("/") if re.fullmatch(r"P[A-H]\d+", n)), None)
        for finger, connector in enumerate(sheet.bom[("Samtec", "FTSH-113-01-L-DV-K")]):
            for i, signal in enumerate(CABLE):
                if connector[i + 1].net.name in nets:
                    reaches[name].add(f"{signal} of finger {finger}")
        for part in sheet.bom[("Texas Instruments", "TCAN1462VDRQ1")]:
            reaches[name] |= {f"{q.name} of the transceiver" for q in part.pins if q.net.name in nets}
    rules["adapter"] = sheet.finish(folder, "adapter")
    return rules, {pin: signals for pin, signals in reaches.items() if signals}

