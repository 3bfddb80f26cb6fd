// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The Studio in its own page, which Look shows in a frame: so its styles, and the parameters that it
 * adds to the address, do not affect Look. Its address has the state of Look, to which it sends
 * what is in it: `{range}`, and changes: `{time}`, `{layout}`, `{error}`, `{note}`, `{ready}`.
 */

import * as state from "./state.js";
import { layoutOf, pack, unpack } from "./studio_layout.js";
import { StoreSource, toNs, toTime } from "./studio_source.js";
import { Layouts, prepare, Settings, SHOWN } from "./studio_storage.js";
import { isAbort } from "./api.js";

const REACT = ["/studio/react/umd/react.production.min.js", "/studio/react-dom/umd/react-dom.production.min.js"];
const STUDIO = "/studio/@foxglove/studio-base/assets/index.js";
const SOURCE = "cassandra_ros";
/** Maximum cache, bytes of serialised messages. The Studio's 1 GB would be several GB as objects. */
const CACHE_BYTES = 96 * 1024 * 1024;
const BLOCK_BYTES = 8 * 1024 * 1024;
/** Size of messages that it may read ahead, within its 10 s, bytes. */
const AHEAD_BYTES = 64 * 1024 * 1024;
const MOST_AHEAD_SEC = 10;

/** @type {any} Global objects of the Studio's scripts. */
const globals = window;

/** @param {Record<string, unknown>} message */
function tell(message) {
  parent.postMessage(message, location.origin);
}

/** @param {unknown} error */
function showError(error) {
  if (!isAbort(error)) tell({ error: error instanceof Error ? error.message : String(error) });
}

/** @param {string} address */
function load(address) {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = address;
    script.addEventListener("load", resolve);
    script.addEventListener("error", () => reject(new Error(`The Studio's file ${address} cannot be loaded.`)));
    document.head.append(script);
  });
}

async function loadStudio() {
  for (const address of REACT) await load(address);
  // The Studio's bundle expects these names.
  globals["react"] = globals.React;
  globals["react-dom"] = globals.ReactDOM;
  await load(STUDIO);
  await globals.initI18n();
}

/**
 * Make the player of the messages. The Studio does not export its player for such sources, but one of
 * its factories makes one, without reading anything.
 * @param {StoreSource} source
 * @param {bigint} time
 */
function makePlayer(source, time) {
  const url = `${location.origin}/none.mcap`;
  const IterablePlayer = new globals.RemoteDataSourceFactory().initialize({ params: { url } }).constructor;
  const player = new IterablePlayer({
    source,
    sourceId: SOURCE,
    enablePreload: source.isSmall,
  });
  boundMemory(player, source);
  player.seekPlayback(toTime(time));
  const listen = player.setListener.bind(player);
  player.setListener = (/** @type {(state: any) => Promise<void>} */ listener) =>
    listen((/** @type {any} */ now) => {
      follow(now);
      return listener(now);
    });
  return player;
}

/**
 * @param {any} player
 * @param {StoreSource} source
 */
function boundMemory(player, source) {
  const buffered = player._bufferedSource;
  const cache = buffered.source;
  cache.maxBlockSizeBytes = BLOCK_BYTES;
  cache.maybePurgeCache = makeRoom.bind(null, cache.cache);
  const seconds = Math.max(1, Number((source.end - source.start) / 1_000_000_000n));
  const ahead = Math.floor(AHEAD_BYTES / (source.found.bytes / seconds + 1));
  buffered.readAheadDuration = { sec: Math.min(MOST_AHEAD_SEC, Math.max(1, ahead)), nsec: 0 };
  // Its cache would give one message for each topic, and so only one of all transforms.
  cache.getBackfillMessages = (/** @type {any} */ args) => source.getBackfillMessages(args);
  // A seek does not wait for messages that are being read at the old time.
  const stop = buffered.stopProducer.bind(buffered);
  buffered.stopProducer = async () => {
    source.interrupt();
    try {
      await stop();
    } catch (error) {
      if (!isAbort(error)) throw error;
      buffered.producer = undefined;
    }
  };
}

/**
 * Remove the least recently used blocks of the cache for a new message. The Studio's own function counts
 * messages of aborted reads that were not kept, and fails if only the block being filled is left.
 * @param {{size: number, lastAccess: number}[]} blocks
 * @param {{activeBlock?: object, sizeInBytes: number}} coming
 * @returns {boolean} Whether a block was removed.
 */
function makeRoom(blocks, { activeBlock, sizeInBytes }) {
  const held = blocks.reduce((sum, block) => sum + block.size, sizeInBytes);
  const others = blocks.filter((block) => block !== activeBlock);
  if (held <= CACHE_BYTES || !others.length) return false;
  const oldest = others.reduce((one, other) => (one.lastAccess <= other.lastAccess ? one : other));
  blocks.splice(blocks.indexOf(oldest), 1);
  return true;
}

let shownTime = 0n;
/** @type {unknown} What was counted last: the same messages may be told again. */
let counted = null;

/** @param {any} now The player's state. */
function follow(now) {
  const data = now.activeData;
  if (!data) return;
  const { dataset } = document.body;
  dataset.presence = now.presence;
  dataset.playing = String(data.isPlaying);
  if (data.messages !== counted) {
    counted = data.messages;
    dataset.messages = String(Number(dataset.messages ?? 0) + data.messages.length);
  }
  const time = toNs(data.currentTime);
  if (time === shownTime) return;
  shownTime = time;
  dataset.time = String(time);
  tell({ time });
}

/** @param {string} text @param {StoreSource} source */
async function chooseLayout(text, source) {
  const usual = layoutOf(source.found.topics, !source.isSmall);
  if (!text) return usual;
  try {
    return await unpack(text);
  } catch (error) {
    showError(error);
    return usual;
  }
}

/** @param {any} layout */
async function keepLayout(layout) {
  // Panels complete their settings on their own: that alone need not be in the address.
  if (/** @type {any} */ (navigator).userActivation?.hasBeenActive) tell({ layout: await pack(layout) });
}

async function start() {
  prepare();
  const asked = state.read();
  const source = new StoreSource(asked, showError, (note) => tell({ note }));
  const opened = source.open().then((found) => {
    tell({ range: { start: source.start, end: source.end } });
    return found;
  });
  const [found] = await Promise.all([opened, loadStudio()]);
  if (!found.topics.length) return; // a note says why
  const time = asked.time ?? source.start;
  const layouts = new Layouts(await chooseLayout(asked.layout, source), keepLayout);
  const factory = {
    id: SOURCE,
    type: "connection",
    displayName: "cassandra_ros",
    iconName: "Database",
    initialize: () => makePlayer(source, time),
  };
  // Otherwise the Studio would choose the last shown layout.
  const own = `?layoutId=${SHOWN}&ds=${SOURCE}`;
  history.replaceState(null, "", own);
  globals.ReactDOM.render(
    globals.React.createElement(globals.App, {
      deepLinks: [location.origin + location.pathname + own],
      appConfiguration: new Settings(),
      dataSources: [factory],
      layoutStorage: layouts,
      extensionLoaders: [],
      enableGlobalCss: true,
    }),
    document.getElementById("root"),
  );
  tell({ ready: true });
}

start().catch(showError);
