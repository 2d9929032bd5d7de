// One frame as the server sends it: src/record.rs says what each byte is.
"use strict";

const HEADER_BYTES = 40, SENSOR_BYTES = 16 + 2 * 16 + 2 * 1024, MEL_BINS = 16, SIDE = 32;
const SLIP = 1, MAY_BEGIN = 2, TRUTH_KNOWN = 4, TRUE_SLIP = 8;
const HEALTH = ["array missing", "accelerometer missing", "accelerometer warming up", "accelerometer clipped",
  "taxels saturated", "samples dropped", "no model", "taxels masked"];

/** A view of one record; nothing is copied. */
function readRecord(buffer, offset) {
  const view = new DataView(buffer, offset);
  const sensors = view.getUint8(18);
  return {
    sequence: view.getUint32(0, true),
    lost: view.getUint32(4, true),
    timestampUs: view.getFloat64(8, true),
    class: view.getUint8(16),
    flags: view.getUint8(17),
    sensors,
    logits: [20, 24, 28].map((at) => view.getInt32(at, true) / 256),
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
