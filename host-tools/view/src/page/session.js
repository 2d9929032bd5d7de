// One recording on the page: a column with all that is known of it.
"use strict";

/** Chunks kept: two minutes. */
const CHUNKS_KEPT = 120;
const RETRY_MS = 500;
/** The strip of the last minute. */
const MINUTE_S = 60;
/** What is an event, and its name in the list. */
const EVENTS = [[TRUE_SLIP, "slip in truth"], [MAY_BEGIN, "may begin"], [SLIP, "slip"], [FAULT, "fault"]];

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

class Session {
  /** `get`: a function of source.js. */
  constructor(get) {
    this.get = get;
    this.element = document.getElementById("session").content.firstElementChild.cloneNode(true);
    this.state = null;
    this.isOpen = true;
    this.clear();
    this.events.addEventListener("change", () => goTo(Number(this.events.value)));
    const scrub = (strip) => (event) => {
      if (event.buttons !== 1) return;
      const { left, width } = strip.getBoundingClientRect();
      const [low, high] = strip === this.$("all") ? this.range() : this.minute(this.shown);
      goTo(low + Math.floor(((event.clientX - left) / width) * (high - low)));
    };
    for (const strip of [this.$("all"), this.$("minute")]) {
      strip.addEventListener("pointerdown", scrub(strip));
      strip.addEventListener("pointermove", scrub(strip));
    }
    this.follow();
  }

  /** The element of this class. */
  $(name) {
    return this.element.querySelector(`.${name}`);
  }

  get events() {
    return this.$("events");
  }

  clear() {
    this.marks = new Uint8Array(0);
    this.marksFirst = 0;
    this.chunks = new Map();   // number of the chunk → what `load` makes of it
    this.asked = new Set();
    this.panels = [];
    this.running = new Map();  // bit → the event that has not ended
    this.shown = 0;
    this.drawn = "";
    this.version = 0;          // of what there is to draw
    this.columns = { key: "" };
    this.events.replaceChildren();
    this.$("sensors").replaceChildren();
  }

  /** Numbers of the frames that are known: first, and one more than the last. */
  range() {
    return [this.marksFirst, this.marksFirst + this.marks.length];
  }

  minute(frame) {
    const [first, end] = this.range(), long = MINUTE_S * this.state.frame_rate_hz;
    const low = Math.max(first, Math.min(frame + 1, end) - long);
    return [low, low + long];
  }

  close() {
    this.isOpen = false;
    this.element.remove();
  }

  /** Ask where the source stands and for the marks that are new, until this is closed. */
  async follow() {
    while (this.isOpen) {
      try {
        const next = JSON.parse(new TextDecoder().decode((await this.get("state")).buffer));
        if (this.state?.id !== next.id) await this.begin(next);
        this.state = next;
        const { first, buffer } = await this.get(`marks?from=${this.marksFirst + this.marks.length}`);
        this.addMarks(first, new Uint8Array(buffer));
        this.problem(next.problem ?? (next.ended && next.live ? "the stream has ended" : ""));
        if (next.ended && this.range()[1] >= next.end) await sleep(RETRY_MS);
      } catch (error) {
        const internal = error instanceof WebAssembly.RuntimeError;
        this.problem(internal ? `stopped by a fault of this page: ${error.message}` : "no connection, trying again");
        await sleep(RETRY_MS);
      }
    }
  }

  /** Another recording, or the server was started again. */
  async begin(next) {
    this.kpa = new Float32Array((await this.get("kpa")).buffer);
    this.clear();
    this.state = next;
    this.$("name").textContent = next.name;
    this.$("model").textContent = next.model === null ? "the module's decisions" : `model: ${next.model}`;
    this.$("synthetic").hidden = next.synthetic !== true;
    began(this);
  }

  problem(text) {
    this.$("problem").textContent = text;
    this.$("problem").hidden = !text;
  }

  addMarks(first, fresh) {
    if (fresh.length === 0) return;
    // Frames that the source has let go of are not shown any more.
    const drop = this.marks.length === 0 ? 0 : Math.max(0, Math.min(this.state.first - this.marksFirst, this.marks.length));
    const keep = first === this.range()[1] ? this.marks.subarray(drop) : new Uint8Array(0);
    const all = new Uint8Array(keep.length + fresh.length);
    all.set(keep);
    all.set(fresh, keep.length);
    this.marksFirst = first - keep.length;
    this.marks = all;
    this.version += 1;
    this.addEvents(first, fresh);
  }

  addEvents(first, fresh) {
    const time = (frames) => (frames / this.state.frame_rate_hz).toFixed(3);
    const options = document.createDocumentFragment();
    for (const [bit, name] of EVENTS) {
      let event = this.running.get(bit);
      for (let i = 0; i < fresh.length; i++) {
        const isSet = (fresh[i] & bit) !== 0;
        if (isSet && !event) {
          event = new Option(`${time(first + i)} s  ${name}`, first + i);
          options.append(event);
        } else if (!isSet && event) {
          event.text += ` for ${time(first + i - Number(event.value))} s`;
          event = undefined;
        }
      }
      this.running.set(bit, event);
    }
    // In the order of their frames; those of earlier marks are before all of these.
    this.events.append(...[...options.children].sort((a, b) => a.value - b.value));
    while (this.events.options.length && Number(this.events.options[0].value) < this.marksFirst) this.events.remove(0);
  }

  /** The first event after a frame, or the last one before it. */
  nextEvent(frame, step) {
    const starts = Array.from(this.events.options, (event) => Number(event.value));
    return step > 0 ? starts.find((start) => start > frame) : starts.findLast((start) => start < frame);
  }

  /** What there is of a chunk; asks for it where it is not whole. */
  chunk(number) {
    const chunk = this.chunks.get(number);
    const [first, end] = this.range(), start = number * this.state.chunk;
    const last = Math.min(start + this.state.chunk, end);
    if (last > Math.max(start, first) && !(chunk && chunk.end >= last)) this.load(number);
    return chunk;
  }

  /** The record of a frame, or null while it is on its way. */
  record(frame) {
    if (!this.state || this.marks.length === 0) return null;
    const number = Math.floor(frame / this.state.chunk), chunk = this.chunk(number);
    if (!chunk || frame < chunk.first || frame >= chunk.end) return null;
    return readRecord(chunk.buffer, (frame - number * this.state.chunk) * this.state.record_bytes);
  }

  /** Get a chunk, or what it lacks: the newest grows. */
  async load(number) {
    if (this.asked.has(number)) return;
    const { id, record_bytes: size, chunk: long } = this.state, start = number * long, { chunks, asked } = this;
    asked.add(number);
    try {
      let chunk = chunks.get(number);
      const { first, buffer } = await this.get(`records?from=${chunk ? chunk.end : start}`);
      if (this.state.id === id && buffer.byteLength >= size && first < start + long) {
        if (!chunk || first !== chunk.end) chunk = new Chunk(start, first, this.state);
        chunk.add(new Uint8Array(buffer));
        // The latest asked for goes last: the first of a map is the one longest not loaded.
        chunks.delete(number);
        chunks.set(number, chunk);
        while (chunks.size > CHUNKS_KEPT) chunks.delete(chunks.keys().next().value);
        this.version += 1;
      }
    } catch {
      // `follow` says that there is no connection.
      await sleep(RETRY_MS);
    }
    asked.delete(number);
  }

  /** Draw a frame, where that changes anything; whether it did. */
  show(frame) {
    if (!this.state || this.marks.length === 0) return false;
    const [first, end] = this.range();
    frame = Math.max(first, Math.min(frame, end - 1));
    const key = `${frame} ${this.version} ${this.element.clientWidth}`;
    if (key === this.drawn) return false;
    this.drawn = key;
    this.shown = frame;
    const long = this.state.chunk, low = frame - SHOWN + 1, numbers = [];
    for (let number = Math.floor(low / long); number * long <= frame; number++) numbers.push(number);
    const parts = numbers.map((number) => this.chunk(number)).filter(Boolean);
    drawLogits(this.$("logits"), parts, low);
    this.drawStrips(frame);
    const shown = this.record(frame);
    if (!shown) return true;
    while (this.panels.length < shown.sensors) {
      this.panels.push(new SensorPanel(this.panels.length, this));
      this.$("sensors").append(this.panels.at(-1).element);
    }
    while (this.panels.length > shown.sensors) this.panels.pop().element.remove();
    this.panels.forEach((panel, index) => {
      panel.drawPad(shown.sensor(index));
      panel.drawMel(parts, low, index);
    });
    this.lamp("class", true, `class: ${["no contact", "contact", "slip"][shown.class] || "?"}`, `--c${shown.class}`);
    this.lamp("may-begin", shown.flags & MAY_BEGIN, "may begin", "--c2");
    this.lamp("slip", shown.flags & SLIP, "slip", "--flag");
    this.$("slip").style.textDecoration = shown.invalid ? "line-through" : "";
    this.$("invalid").textContent = shown.invalid ? `do not believe it: ${named(this.state.invalid, shown.invalid)}` : "";
    this.$("degraded").textContent = named(this.state.degraded, shown.degraded);
    this.$("time").textContent = `${(shown.timestampUs / 1e6).toFixed(3)} s · frame ${shown.sequence}`;
    this.$("counts").textContent = `${this.state.lost} lost · ${shown.late} late`;
    return true;
  }

  drawStrips(frame) {
    const [first, end] = this.range(), all = this.$("all"), minute = this.$("minute");
    const width = all.clientWidth, key = `${first} ${end} ${width}`;
    // A pass over all frames takes a millisecond for each hour of them.
    if (this.columns.key !== key) this.columns = { key, marks: columnsOf(this.marks, 0, this.marks.length, width) };
    drawStrip(all, this.columns.marks, (frame - first) / (end - first));
    const [low, high] = this.minute(frame);
    minute.parentElement.hidden = end - first <= high - low;
    if (minute.parentElement.hidden) return;
    drawStrip(minute, columnsOf(this.marks, low - first, high - first, minute.clientWidth), (frame - low) / (high - low));
  }

  lamp(name, on, text, colour) {
    const lamp = this.$(name);
    lamp.textContent = text;
    lamp.classList.toggle("on", Boolean(on));
    lamp.style.background = on ? `var(${colour})` : "";
  }
}

/** A second of records, and what is drawn of them again and again. */
class Chunk {
  constructor(start, first, { chunk, record_bytes: size, sensors }) {
    Object.assign(this, { start, first, end: first, size });
    this.buffer = new ArrayBuffer(chunk * size);
    this.logits = [0, 1, 2].map(() => new Float32Array(chunk));
    this.mels = Array.from({ length: sensors }, () => Array.from({ length: MEL_BINS }, () => new Uint32Array(chunk)));
  }

  add(bytes) {
    const whole = bytes.subarray(0, this.buffer.byteLength - (this.end - this.start) * this.size);
    new Uint8Array(this.buffer).set(whole, (this.end - this.start) * this.size);
    const end = this.end + whole.length / this.size;
    for (; this.end < end; this.end++) {
      const at = this.end - this.start, record = readRecord(this.buffer, at * this.size);
      record.logits.forEach((logit, row) => { this.logits[row][at] = logit; });
      this.mels.forEach((rows, sensor) => {
        const mel = sensor < record.sensors ? record.sensor(sensor).mel : null;
        rows.forEach((row, bin) => { row[at] = melColour(mel ? mel[bin] : 0); });
      });
    }
  }

  /** The part from frame `low` on: index of the first frame, of the end, and the column of the first. */
  part(low, shown) {
    const from = Math.max(low, this.first), to = Math.min(low + shown, this.end);
    return from < to ? [from - this.start, to - this.start, from - low] : [0, 0, 0];
  }
}
