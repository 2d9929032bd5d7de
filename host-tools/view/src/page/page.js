// Which frame is shown, and of which recordings.
"use strict";

const FRAME_RATE_HZ = 240;
/** Columns of the page. */
const SESSIONS_MAX = 4;

const $ = (id) => document.getElementById(id);
let sessions = [];
let position = 0;          // frame shown, with the part of a frame that playing has come
let playing = true, following = false;
let lastTick = 0, drawn = 0, drawnMs = 0, drawnSince = performance.now();
let files = { recordings: [], networks: [] };  // what was dropped here

/** First and last frame of all sessions. */
function range() {
  const ranges = sessions.filter((session) => session.marks.length > 0).map((session) => session.range());
  return [Math.min(...ranges.map(([first]) => first)), Math.max(...ranges.map(([, end]) => end - 1))];
}

/** These sources, side by side. */
function view(sources) {
  sessions.forEach((session) => session.close());
  sessions = sources.map((source) => new Session(source));
  $("sessions").replaceChildren(...sessions.map((session) => session.element));
}

/** A session begins, or begins anew. */
function began(session) {
  position = 0;
  playing = true;
  following = session.state.live;
  $("live").hidden = !sessions.some((session) => session.state?.live);
  document.title = `SlipSense – ${session.state.name}`;
}

function goTo(frame) {
  const [first, last] = range();
  following = false;
  position = Math.max(first, Math.min(frame, last));
}

function toEvent(step) {
  const frames = sessions.map((session) => session.nextEvent(Math.floor(position), step));
  const found = frames.filter((frame) => frame !== undefined);
  playing = false;
  if (found.length) goTo(step > 0 ? Math.min(...found) : Math.max(...found));
}

function tick(now) {
  const [first, last] = range();
  if (last >= first) {
    if (following) {
      position = last;
    } else if (playing) {
      position += ((now - lastTick) / 1000) * FRAME_RATE_HZ * Number($("speed").value);
      if (position >= last && sessions.every((session) => session.state?.ended)) playing = false;
    }
    position = Math.max(first, Math.min(position, last));
    const start = performance.now();
    if (sessions.map((session) => session.show(Math.floor(position))).some(Boolean)) drawn += 1;
    drawnMs += performance.now() - start;
    $("play").textContent = playing ? "Pause" : "Play";
    if (now - drawnSince > 1000) {
      const each = drawn ? `, ${(drawnMs / drawn).toFixed(1)} ms each` : "";
      $("fps").textContent = `${((1000 * drawn) / (now - drawnSince)).toFixed(0)} pictures/s${each}`;
      drawn = drawnMs = 0;
      drawnSince = now;
    }
  }
  lastTick = now;
  requestAnimationFrame(tick);
}

function play() {
  const [first, last] = range();
  playing = !playing;
  following = false;
  if (playing && position >= last) position = first;
}

const step = (frames) => { playing = false; goTo(Math.floor(position) + frames); };
const KEYS = {
  " ": play,
  ArrowLeft: (event) => step(event.shiftKey ? -FRAME_RATE_HZ : -1),
  ArrowRight: (event) => step(event.shiftKey ? FRAME_RATE_HZ : 1),
  Home: () => goTo(range()[0]),
  End: () => { goTo(range()[1]); following = sessions.some((session) => session.state?.live); },
  n: () => toEvent(1),
  p: () => toEvent(-1),
};

document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "SELECT" || !KEYS[event.key] || sessions.length === 0) return;
  event.preventDefault();
  KEYS[event.key](event);
});
$("play").addEventListener("click", play);
$("live").addEventListener("click", () => { following = playing = true; });

/** Show each of these recordings with the page's network and each of the others; the first that is wrong stops all. */
async function open({ recordings, networks }) {
  $("problem").hidden = true;
  try {
    const isEpisode = (recording) => recording?.name.endsWith(".npz") ?? true;
    if (networks.length && !(recordings.length && recordings.every(isEpisode))) {
      throw new Error(`${networks.at(-1).name}: a network runs on an episode (.npz): drop one first, or beside it`);
    }
    const pairs = recordings.flatMap((recording) => [null, ...networks].map((network) => [recording, network]));
    if (pairs.length > SESSIONS_MAX) throw new Error(`${pairs.length} columns: at most ${SESSIONS_MAX} are shown`);
    const node = Number($("node").value);
    const sources = await Promise.all(pairs.map(([recording, network]) => fromFile(recording, network, node)));
    files = { recordings, networks };
    $("hint").hidden = true;
    view(sources);
  } catch (error) {
    $("problem").textContent = error.message;
    $("problem").hidden = false;
  }
}

/** Files that were dropped: recordings replace those shown, networks (.slipnet) join them. */
async function take(list) {
  try {
    const read = async (file) => ({ name: file.name, bytes: new Uint8Array(await file.arrayBuffer()) });
    const taken = await Promise.all(Array.from(list, read));
    const isNetwork = ({ name }) => name.endsWith(".slipnet");
    const recordings = taken.filter((file) => !isNetwork(file)), networks = taken.filter(isNetwork);
    await open(recordings.length ? { recordings, networks } : { ...files, networks: [...files.networks, ...networks] });
  } catch (error) {
    $("problem").textContent = `${list[0]?.name}: cannot be read by the browser: ${error.message}`;
    $("problem").hidden = false;
  }
}

async function start() {
  if (typeof MODULE !== "undefined") {
    $("files").hidden = $("hint").hidden = false;
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => { event.preventDefault(); take(event.dataTransfer.files); });
    $("choose").addEventListener("change", () => take($("choose").files));
    $("demo").addEventListener("click", () => open({ recordings: [null], networks: [] }));
    return;
  }
  const count = await (await fetch("sessions")).json();
  view(Array.from({ length: count }, (_, number) => fromServer(number)));
}

start();
requestAnimationFrame(tick);
