// Where frames come from, and what their bytes mean: src/frames.rs has the requests, src/record.rs the records.
"use strict";

const HEADER_BYTES = 40, SENSOR_BYTES = 16 + 2 * 16 + 2 * 1024, MEL_BINS = 16, SIDE = 32, LOGIT_ONE = 1024;
const SLIP = 1, MAY_BEGIN = 2, TRUTH_KNOWN = 4, TRUE_SLIP = 8, IN_CONTACT = 48, FAULT = 64, INVALID = 128;

/** The names of the bits that are set; `table`: [bit, name] of each. */
const named = (table, bits) => table.filter(([bit]) => bits & bit).map(([, name]) => name).join(", ");

/** The frames of one session of `slipsense view`: a function from a request to the number of a frame, and bytes. */
const fromServer = (number) => (request) => {
  const answer = lastAnswer.then(() => asked(number, request));
  lastAnswer = answer.catch(() => {});
  return answer;
};

/** One request at a time: of connections opened at once, the server's threads may leave one waiting for ever. */
let lastAnswer = Promise.resolve();

async function asked(number, request) {
  const response = await fetch(`${number}/${request}`, { cache: "no-store" });
  if (!response.ok) throw new Error(`${request}: ${response.status}`);
  return { first: Number(response.headers.get("First-Frame")), buffer: await response.arrayBuffer() };
}

/** How long the pipeline runs before the page draws again. */
const SLICE_MS = 25;
let compiled = null;

/** The same of a file in this browser: `{ name, bytes }` and a network, or null for those that the page holds. */
async function fromFile(recording, network, node) {
  compiled ??= WebAssembly.compile(Uint8Array.from(atob(MODULE), (letter) => letter.charCodeAt(0)));
  // The reader of zip archives brings wasm-bindgen along, for random numbers that nothing here asks for.
  const imports = {};
  for (const { module, name } of WebAssembly.Module.imports(await compiled)) {
    (imports[module] ??= {})[name] = () => { throw new Error(`${name} is not in this page`); };
  }
  const { exports: wasm } = await WebAssembly.instantiate(await compiled, imports);
  const text = new TextEncoder(), none = { name: "", bytes: new Uint8Array(0) };
  const give = (bytes) => {
    const at = wasm.input(bytes.length);
    new Uint8Array(wasm.memory.buffer, at, bytes.length).set(bytes);
  };
  const said = (length) => wasm.memory.buffer.slice(wasm.output(), wasm.output() + length);
  for (const { name, bytes } of [recording ?? none, network ?? none]) {
    give(text.encode(name));
    give(bytes);
  }
  const problem = new TextDecoder().decode(said(wasm.open(node)));
  if (problem) throw new Error(problem);
  let more = true;
  return async (request) => {
    if (more && request === "state") {
      await new Promise((resolve) => setTimeout(resolve));
      const end = performance.now() + SLICE_MS;
      while (more && performance.now() < end) more = wasm.advance(8) !== 0;
    }
    give(text.encode(request));
    const answer = said(wasm.answer());
    return { first: Number(new DataView(answer).getBigUint64(0, true)), buffer: answer.slice(8) };
  };
}

/** A view of one record; nothing is copied. */
function readRecord(buffer, offset) {
  const view = new DataView(buffer, offset);
  return {
    sequence: view.getUint32(0, true),
    lost: view.getUint32(4, true),
    timestampUs: view.getFloat64(8, true),
    class: view.getUint8(16),
    flags: view.getUint8(17),
    sensors: view.getUint8(18),
    logits: [20, 24, 28].map((at) => view.getInt32(at, true) / LOGIT_ONE),
    invalid: view.getUint8(19),
    late: view.getUint8(32),
    degraded: view.getUint8(33),
    sensor(index) {
      const at = HEADER_BYTES + index * SENSOR_BYTES, start = offset + at;
      const there = view.getUint8(at + 1);
      return {
        health: view.getUint8(at),
        area: view.getUint16(at + 2, true),
        sum: view.getUint32(at + 4, true),
        row: view.getUint16(at + 8, true) / 256,
        col: view.getUint16(at + 10, true) / 256,
        axisDeg: view.getInt8(at + 12),
        elongation: view.getUint8(at + 13) / 256,
        // Records and their parts lie at even offsets, and this computer is little endian where browsers run.
        mel: there & 2 ? new Int16Array(buffer, start + 16, MEL_BINS) : null,
        taxels: there & 1 ? new Uint16Array(buffer, start + 16 + 2 * MEL_BINS, SIDE * SIDE) : null,
      };
    },
  };
}
