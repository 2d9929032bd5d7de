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

const style = getComputedStyle(document.documentElement);
const colour = (name) => style.getPropertyValue(name).trim();

/** The canvases of one sensor. */
class SensorPanel {
  constructor(index) {
    this.element = document.createElement("div");
    this.element.className = "sensor";
    this.element.innerHTML = `<h2>Sensor ${index + 1}</h2><canvas class="pad" width="32" height="32"></canvas>
      <div class="numbers"></div><h2>Log-mel, ${SHOWN / 240} s</h2>
      <canvas class="mel" width="${SHOWN}" height="${MEL_BINS}"></canvas><div class="health"></div>`;
    const [pad, mel] = this.element.querySelectorAll("canvas");
    this.pad = pad.getContext("2d");
    this.mel = mel.getContext("2d");
    this.padPixels = this.pad.createImageData(SIDE, SIDE);
    this.melPixels = this.mel.createImageData(SHOWN, MEL_BINS);
    this.numbers = this.element.querySelector(".numbers");
    this.health = this.element.querySelector(".health");
  }

  drawPad(sensor) {
    const pixels = new Uint32Array(this.padPixels.data.buffer);
    for (let i = 0; i < pixels.length; i++) {
      const share = sensor.taxels ? Math.sqrt(Math.min(sensor.taxels[i] / BRIGHT, 1)) : 0;
      pixels[i] = PALETTE[(255 * share) | 0];
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
    this.numbers.textContent = `sum ${sensor.sum} · ${sensor.area} taxels · ` +
      (sensor.area > 0 ? `centre ${sensor.row.toFixed(1)}, ${sensor.col.toFixed(1)}` : "no contact") +
      (sensor.taxels ? "" : " · no raw data");
    this.health.textContent = HEALTH.filter((_, bit) => sensor.health >> bit & 1).join(", ");
  }

  /** `melOf(column)`: the log-mel of a column's frame, or null. */
  drawMel(melOf) {
    const pixels = new Uint32Array(this.melPixels.data.buffer);
    const [dark, bright] = MEL_RANGE, scale = 255 / (256 * (bright - dark));
    for (let x = 0; x < SHOWN; x++) {
      const mel = melOf(x);
      for (let bin = 0; bin < MEL_BINS; bin++) {
        const level = mel ? (mel[bin] - 256 * dark) * scale : 0;
        pixels[(MEL_BINS - 1 - bin) * SHOWN + x] = PALETTE[Math.max(0, Math.min(255, level | 0))];
      }
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

/** `logitsOf(column)`: three logits, or null. */
function drawLogits(canvas, logitsOf) {
  const { context, width, height } = fitted(canvas);
  const columns = Array.from({ length: SHOWN }, (_, x) => logitsOf(x));
  const most = columns.reduce((most, logits) => logits ? Math.max(most, ...logits.map(Math.abs)) : most, 4);
  const y = (logit) => height / 2 - (logit / most) * (height / 2 - 4);
  context.strokeStyle = colour("--line");
  context.strokeRect(0, Math.round(height / 2) + 0.5, width, 0);
  for (let c = 0; c < 3; c++) {
    context.strokeStyle = colour(`--c${c}`);
    context.lineWidth = c === 2 ? 2 : 1;
    context.beginPath();
    let drawing = false;
    columns.forEach((logits, x) => {
      if (logits) context[drawing ? "lineTo" : "moveTo"]((x / SHOWN) * width, y(logits[c]));
      drawing = Boolean(logits);
    });
    context.stroke();
  }
  context.fillStyle = colour("--dim");
  context.font = "11px system-ui";
  context.fillText(`±${most.toFixed(0)}`, 4, 12);
}

/** All frames from `first` on: their marks, and where the shown one is. */
function drawTimeline(canvas, marks, position) {
  const { context, width, height } = fitted(canvas);
  const rows = [[TRUE_SLIP, "--truth"], [MAY_BEGIN, "--c2"], [SLIP, "--flag"]];
  const perPixel = Math.max(marks.length / width, 1e-9), high = (height - 8) / rows.length;
  rows.forEach(([bit, name], row) => {
    context.fillStyle = colour("--back");
    context.fillRect(0, row * (high + 4), width, high);
    context.fillStyle = colour(name);
    for (let x = 0; x < width; x++) {
      const end = Math.max(Math.floor((x + 1) * perPixel), Math.floor(x * perPixel) + 1);
      for (let i = Math.floor(x * perPixel); i < end && i < marks.length; i++) {
        if (marks[i] & bit) {
          context.fillRect(x, row * (high + 4), 1, high);
          break;
        }
      }
    }
  });
  context.fillStyle = colour("--text");
  context.fillRect((position / Math.max(marks.length, 1)) * width - 1, 0, 2, height);
}
