// What is on the canvases.
"use strict";

const STOPS = [[0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51],
  [249, 140, 10], [249, 201, 50], [252, 255, 164]];
/** 256 colours, dark to bright, as 32-bit pixels. */
const PALETTE = Uint32Array.from({ length: 256 }, (_, i) => {
  const place = (i / 255) * (STOPS.length - 1), below = Math.min(Math.floor(place), STOPS.length - 2);
  const mix = (c) => Math.round(STOPS[below][c] + (place - below) * (STOPS[below + 1][c] - STOPS[below][c]));
  return (255 << 24 | mix(2) << 16 | mix(1) << 8 | mix(0)) >>> 0;
});
/** Frames that log-mel and logits show: 4 s. */
const SHOWN = 960;
/** Counts of the brightest colour. */
const BRIGHT = 1600;
/** Log-mel, nat of LSB²: darkest and brightest. */
const MEL_RANGE = [4, 20];
/** Rows of the strips. */
const ROWS = [[TRUE_SLIP, "--truth"], [IN_CONTACT, "--c1"], [MAY_BEGIN, "--c2"], [SLIP, "--flag"], [FAULT, "--fault"]];

const style = getComputedStyle(document.documentElement);
const colour = (name) => style.getPropertyValue(name).trim();

/** `ln_power`: 1/256 nat. */
function melColour(lnPower) {
  const [dark, bright] = MEL_RANGE, level = ((lnPower / 256 - dark) / (bright - dark)) * 255;
  return PALETTE[Math.max(0, Math.min(255, level | 0))];
}

/** The canvases of one sensor. */
class SensorPanel {
  constructor(index, { state, kpa }) {
    this.kpa = kpa;
    this.state = state;
    // Power relative to 1 g², or to 1 LSB² where nobody says what a step of the accelerometer is.
    this.unitDb = state.xl_lsb_g ? 20 * Math.log10(state.xl_lsb_g) : 0;
    this.dbName = state.xl_lsb_g ? "dB re 1 g²" : "dB re 1 LSB²";
    this.element = document.createElement("div");
    this.element.className = "sensor";
    const [low, high] = MEL_RANGE.map((nat) => this.db(256 * nat).toFixed(0)), hz = state.mel_hz.map((hz) => hz.toFixed(0));
    this.element.innerHTML = `<h2>Sensor ${index + 1} <span class="health"></span></h2>
      <canvas class="pad" width="32" height="32"></canvas><div class="numbers"></div>
      <h2>Log-mel, ${SHOWN / 240} s, ${hz[0]} to ${hz.at(-1)} Hz, ${low} to ${high} ${this.dbName}</h2>
      <canvas class="mel" width="${SHOWN}" height="${MEL_BINS}"></canvas><div class="loudest"></div>`;
    const [pad, mel] = this.element.querySelectorAll("canvas");
    this.pad = pad.getContext("2d");
    this.mel = mel.getContext("2d");
    this.padPixels = this.pad.createImageData(SIDE, SIDE);
    this.melPixels = this.mel.createImageData(SHOWN, MEL_BINS);
    [this.health, this.numbers, this.loudest] =
      ["health", "numbers", "loudest"].map((name) => this.element.querySelector(`.${name}`));
    pad.addEventListener("pointermove", (event) => {
      const { left, top, width } = pad.getBoundingClientRect();
      const [col, row] = [event.clientX - left, event.clientY - top].map((at) => Math.floor((at / width) * SIDE));
      const count = this.taxels?.[row * SIDE + col];
      pad.title = count === undefined ? "" : `row ${row}, column ${col}: ${count} counts, ${this.kpa[count].toFixed(1)} kPa`;
    });
  }

  db(lnPower) {
    return (10 / Math.LN10) * (lnPower / 256) + this.unitDb;
  }

  drawPad(sensor) {
    const pixels = new Uint32Array(this.padPixels.data.buffer);
    this.taxels = sensor.taxels;
    let sum = 0, peak = 0;
    for (let i = 0; i < pixels.length; i++) {
      const count = sensor.taxels ? sensor.taxels[i] : 0, kpa = this.kpa[count];
      pixels[i] = PALETTE[(255 * Math.sqrt(Math.min(count / BRIGHT, 1))) | 0];
      sum += kpa;
      peak = Math.max(peak, kpa);
    }
    this.pad.putImageData(this.padPixels, 0, 0);
    if (sensor.area > 0) {
      this.pad.strokeStyle = colour("--truth");
      this.pad.lineWidth = 0.4;
      const angle = (sensor.axisDeg * Math.PI) / 180, half = 2 + 4 * sensor.elongation;
      const [x, y] = [sensor.col + 0.5, sensor.row + 0.5];
      this.pad.beginPath();
      this.pad.moveTo(x - half * Math.cos(angle), y - half * Math.sin(angle));
      this.pad.lineTo(x + half * Math.cos(angle), y + half * Math.sin(angle));
      this.pad.stroke();
    }
    // kPa times mm² is mN.
    const force = `${((sum * this.state.taxel_mm2) / 1000).toFixed(1)} N, peak ${peak.toFixed(0)} kPa (nominal film)`;
    this.numbers.textContent = (sensor.taxels ? force : `no raw data · sum ${sensor.sum}`) + ` · ${sensor.area} taxels · ` +
      (sensor.area > 0 ? `centre ${sensor.row.toFixed(1)}, ${sensor.col.toFixed(1)}` : "no contact");
    this.health.textContent = named(this.state.health, sensor.health) || "healthy";
    this.health.classList.toggle("bad", (sensor.health & ~this.state.no_fault) !== 0);
    const bin = sensor.mel ? sensor.mel.indexOf(Math.max(...sensor.mel)) : -1;
    this.loudest.textContent = bin < 0 ? "no samples"
      : `loudest: ${this.state.mel_hz[bin].toFixed(0)} Hz, ${this.db(sensor.mel[bin]).toFixed(0)} ${this.dbName}`;
  }

  /** `parts`: chunks; the first column is frame `low`. */
  drawMel(parts, low, sensor) {
    const pixels = new Uint32Array(this.melPixels.data.buffer).fill(PALETTE[0]);
    for (const chunk of parts) {
      const [from, to, column] = chunk.part(low, SHOWN);
      chunk.mels[sensor].forEach((row, bin) => {
        pixels.set(row.subarray(from, to), (MEL_BINS - 1 - bin) * SHOWN + column);
      });
    }
    this.mel.putImageData(this.melPixels, 0, 0);
  }
}

/** Fit a canvas to its place; its context, in CSS pixels. */
function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** `parts`: chunks; the first column is frame `low`. */
function drawLogits(canvas, parts, low) {
  const { context, width, height } = fitted(canvas);
  let most = 4;
  for (const chunk of parts) {
    const [from, to] = chunk.part(low, SHOWN);
    for (const row of chunk.logits) for (let i = from; i < to; i++) most = Math.max(most, Math.abs(row[i]));
  }
  context.strokeStyle = colour("--line");
  context.strokeRect(0, Math.round(height / 2) + 0.5, width, 0);
  for (let c = 0; c < 3; c++) {
    context.strokeStyle = colour(`--c${c}`);
    context.lineWidth = c === 2 ? 2 : 1;
    context.beginPath();
    let next = -1;
    for (const chunk of parts) {
      const [from, to, column] = chunk.part(low, SHOWN);
      for (let i = from; i < to; i++) {
        const x = column + i - from, y = height / 2 - (chunk.logits[c][i] / most) * (height / 2 - 4);
        context[x === next ? "lineTo" : "moveTo"]((x / SHOWN) * width, y);
        next = x + 1;
      }
    }
    context.stroke();
  }
  context.fillStyle = colour("--dim");
  context.font = "11px system-ui";
  context.fillText(`±${most.toFixed(0)}`, 4, 12);
}

/** What any frame of each pixel's has, of the marks from `low` to `high`. */
function columnsOf(marks, low, high, width) {
  const columns = new Uint8Array(width), perPixel = (high - low) / width;
  for (let x = 0; x < width; x++) {
    const start = low + Math.floor(x * perPixel), end = Math.max(low + Math.floor((x + 1) * perPixel), start + 1);
    for (let i = start; i < end && i < marks.length; i++) columns[x] |= marks[i];
  }
  return columns;
}

/** `columns`: marks of each pixel; `place`: where the shown frame is, 0 to 1. */
function drawStrip(canvas, columns, place) {
  const { context, width, height } = fitted(canvas);
  const high = height / ROWS.length;
  ROWS.forEach(([bit, name], row) => {
    context.fillStyle = colour("--back");
    context.fillRect(0, row * high, width, high - 3);
    context.fillStyle = colour(name);
    for (let x = 0; x < columns.length; x++) {
      const start = x;
      while (x < columns.length && columns[x] & bit) x++;
      if (x > start) context.fillRect(start, row * high, x - start, high - 3);
    }
  });
  context.fillStyle = colour("--text");
  context.fillRect(place * width - 1, 0, 2, height);
}
