// Which frame is shown, and where the frames come from.
"use strict";

/** Frames asked for at once: a second. */
const CHUNK = 240;
/** Chunks kept: two minutes. */
const CHUNKS_KEPT = 120;
const RETRY_MS = 500;

const $ = (id) => document.getElementById(id);
const panels = [];
let state = null;          // of the server
let marks = new Uint8Array(0), marksFirst = 0;
let chunks = new Map();    // number of the chunk → { first, end, buffer }: frames first to end − 1 are there
const asked = new Set();
let position = 0;          // frame shown, with the part of a frame that playing has come
let playing = true, following = false;
let lastTick = 0, drawn = 0, drawnSince = performance.now();

/** Number of the newest frame whose mark is here. */
const newest = () => marksFirst + marks.length - 1;
const clamp = (frame) => Math.max(marksFirst, Math.min(frame, newest()));

async function get(path) {
  const response = await fetch(path, { cache: "no-store" });
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return response;
}

/** Begin anew: another recording, or the server was started again. */
function reset(next) {
  marks = new Uint8Array(0);
  marksFirst = 0;
  chunks = new Map();
  position = 0;
  playing = true;
  following = next.live;
  $("name").textContent = next.name;
  $("synthetic").hidden = next.synthetic !== true;
  $("live").hidden = !next.live;
  document.title = `SlipSense – ${next.name}`;
}

/** Ask where the server stands and for the marks that are new, for ever. */
async function follow() {
  for (;;) {
    try {
      const next = await (await get("state")).json();
      if (!state || state.id !== next.id) reset(next);
      state = next;
      const response = await get(`marks?from=${marksFirst + marks.length}`);
      const first = Number(response.headers.get("First-Frame"));
      addMarks(first, new Uint8Array(await response.arrayBuffer()));
      connection(state.problem ? state.problem : state.ended && state.live ? "the stream has ended" : "");
      if (state.ended && newest() + 1 >= state.end) await sleep(RETRY_MS);
    } catch {
      connection("no connection, trying again");
      await sleep(RETRY_MS);
    }
  }
}

function addMarks(first, fresh) {
  if (fresh.length === 0) return;
  // Frames that the server has let go of are not shown any more.
  const drop = marks.length === 0 ? 0 : Math.max(0, Math.min(state.first - marksFirst, marks.length));
  const keep = first === marksFirst + marks.length ? marks.subarray(drop) : new Uint8Array(0);
  const all = new Uint8Array(keep.length + fresh.length);
  all.set(keep);
  all.set(fresh, keep.length);
  marksFirst = first - keep.length;
  marks = all;
}

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

function connection(text) {
  $("connection").textContent = text;
  $("connection").hidden = !text;
}

/** The record of a frame, or null while it is on its way. */
function record(frame) {
  if (!state || frame < marksFirst || frame > newest()) return null;
  const number = Math.floor(frame / CHUNK), chunk = chunks.get(number);
  if (chunk && frame >= chunk.first && frame < chunk.end) {
    return readRecord(chunk.buffer, (frame - number * CHUNK) * state.record_bytes);
  }
  load(number);
  return null;
}

/** Get a chunk, or what it lacks: the newest grows. */
async function load(number) {
  if (asked.has(number)) return;
  asked.add(number);
  const { id, record_bytes: size } = state, start = number * CHUNK;
  let chunk = chunks.get(number);
  try {
    const from = chunk ? chunk.end : start;
    const response = await get(`records?from=${from}&count=${start + CHUNK - from}`);
    const first = Number(response.headers.get("First-Frame")), bytes = new Uint8Array(await response.arrayBuffer());
    if (state.id === id && bytes.length >= size && first < start + CHUNK) {
      if (!chunk || first !== chunk.end) chunk = { first, end: first, buffer: new ArrayBuffer(CHUNK * size) };
      const whole = bytes.subarray(0, (start + CHUNK - first) * size);
      new Uint8Array(chunk.buffer).set(whole, (first - start) * size);
      chunk.end = first + whole.length / size;
      // The latest asked for goes last: the first of a map is the one longest not loaded.
      chunks.delete(number);
      chunks.set(number, chunk);
      while (chunks.size > CHUNKS_KEPT) chunks.delete(chunks.keys().next().value);
    }
  } catch {
    // `follow` says that there is no connection.
    await sleep(RETRY_MS);
  }
  asked.delete(number);
}

function seek(frame) {
  following = false;
  position = clamp(frame);
}

/** The first frame of the next or previous run of slip frames, by class or by truth. */
function slipFrom(step) {
  const bits = MAY_BEGIN | TRUE_SLIP;
  const slips = (i) => (marks[i] & bits) !== 0 && (i === 0 || (marks[i - 1] & bits) === 0);
  for (let i = Math.floor(position) - marksFirst + step; i >= 0 && i < marks.length; i += step) {
    if (slips(i)) return marksFirst + i;
  }
  return Math.floor(position);
}

function show(frame) {
  const shown = record(frame);
  const at = (x) => (frame - SHOWN + 1 + x >= marksFirst ? record(frame - SHOWN + 1 + x) : null);
  // Each frame is read once for all panels.
  const window = Array.from({ length: SHOWN }, (_, x) => at(x));
  drawLogits($("logits"), (x) => window[x] && window[x].logits);
  drawTimeline($("timeline"), marks, frame - marksFirst);
  $("timeline").setAttribute("aria-valuenow", frame);
  if (!shown) return;
  while (panels.length < shown.sensors) {
    panels.push(new SensorPanel(panels.length));
    $("sensors").append(panels.at(-1).element);
  }
  while (panels.length > shown.sensors) panels.pop().element.remove();
  panels.forEach((panel, index) => {
    panel.drawPad(shown.sensor(index));
    panel.drawMel((x) => window[x] && index < window[x].sensors ? window[x].sensor(index).mel : null);
  });
  lamp("class", true, ["no contact", "contact", "slip"][shown.class] || "?", `--c${shown.class}`);
  lamp("may-begin", shown.flags & MAY_BEGIN, "may begin", "--c2");
  lamp("slip", shown.flags & SLIP, "slip", "--flag");
  $("slip").title = `invalid ${shown.invalid}, degraded ${shown.degraded}`;
  $("slip").style.textDecoration = shown.invalid ? "line-through" : "";
  $("time").textContent = `${(shown.timestampUs / 1e6).toFixed(3)} s · frame ${shown.sequence}`;
  $("counts").textContent = `${state.lost} lost · ${shown.late} late`;
}

function lamp(id, on, text, name) {
  $(id).textContent = text;
  $(id).classList.toggle("on", Boolean(on));
  $(id).style.background = on ? `var(${name})` : "";
}

function tick(now) {
  if (state && marks.length > 0) {
    if (following) {
      position = newest();
    } else if (playing) {
      position += ((now - lastTick) / 1000) * state.frame_rate_hz * Number($("speed").value);
      if (position >= newest() && state.ended) playing = false;
    }
    position = clamp(position);
    show(Math.floor(position));
    $("play").textContent = playing ? "Pause" : "Play";
    drawn += 1;
    if (now - drawnSince > 1000) {
      $("fps").textContent = `${((1000 * drawn) / (now - drawnSince)).toFixed(0)} pictures/s`;
      drawn = 0;
      drawnSince = now;
    }
  }
  lastTick = now;
  requestAnimationFrame(tick);
}

function play() {
  playing = !playing;
  following = false;
  if (playing && position >= newest()) position = marksFirst;
}

const KEYS = {
  " ": play,
  ArrowLeft: (event) => { playing = false; seek(Math.floor(position) - (event.shiftKey ? CHUNK : 1)); },
  ArrowRight: (event) => { playing = false; seek(Math.floor(position) + (event.shiftKey ? CHUNK : 1)); },
  Home: () => seek(marksFirst),
  End: () => { seek(newest()); following = Boolean(state && state.live); },
  n: () => { playing = false; seek(slipFrom(1)); },
  p: () => { playing = false; seek(slipFrom(-1)); },
};

document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "SELECT" || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key](event);
});
$("play").addEventListener("click", play);
$("live").addEventListener("click", () => { following = playing = true; });
const scrub = (event) => {
  if (event.buttons !== 1) return;
  const { left, width } = $("timeline").getBoundingClientRect();
  seek(marksFirst + Math.floor(((event.clientX - left) / width) * marks.length));
};
$("timeline").addEventListener("pointerdown", scrub);
$("timeline").addEventListener("pointermove", scrub);

follow();
requestAnimationFrame(tick);
