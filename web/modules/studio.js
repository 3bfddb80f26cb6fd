// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The Studio in a page of its own, which Look frames: it has the page to itself, its styles stay
 * here, and so does what its own state adds to the address. Its address has the state of Look's,
 * which is told what changes: `{time}`, `{layout}`, `{error}`, `{ready}`.
 */

import * as state from "./state.js";
import { layoutOf, pack, unpack } from "./studio_layout.js";
import { StoreSource, toNs, toTime } from "./studio_source.js";
import { Layouts, prepare, Settings, SHOWN } from "./studio_storage.js";
import { isAbort } from "./api.js";

const REACT = ["/studio/react/umd/react.production.min.js", "/studio/react-dom/umd/react-dom.production.min.js"];
const STUDIO = "/studio/@foxglove/studio-base/assets/index.js";
const SOURCE = "cassandra_ros";
/** The Studio's own bound is 1 GB of messages as sent; as objects they take several times that. */
const CACHE_BYTES = 96 * 1024 * 1024;
const BLOCK_BYTES = 8 * 1024 * 1024;
/** So much it may read ahead, of its 10 s. */
const AHEAD_BYTES = 64 * 1024 * 1024;
const MOST_AHEAD_SEC = 10;

/** What the Studio's scripts leave behind. @type {any} */
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
  // By these names the Studio's bundle asks for them.
  globals["react"] = globals.React;
  globals["react-dom"] = globals.ReactDOM;
  await load(STUDIO);
  await globals.initI18n();
}

/**
 * Make what plays the messages. The Studio's player for such sources is not exported by name, but
 * one of its factories makes one; nothing is read by that.
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
  // Of its cache it would give one message of a topic, and so one frame of all the transforms.
  cache.getBackfillMessages = (/** @type {any} */ args) => source.getBackfillMessages(args);
  // Who goes elsewhere does not wait for what is being read here.
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
 * Forget what was looked at longest ago, for a message to come. The Studio's own counts what a reading
 * that was broken off had not kept, and gives up where only the block is left that is being filled.
 * @param {{size: number, lastAccess: number}[]} blocks
 * @param {{activeBlock?: object, sizeInBytes: number}} coming
 * @returns {boolean} Whether something was forgotten.
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
/** What was counted last: the same messages may be told again. @type {unknown} */
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
  // Panels complete their settings by themselves: that alone is no change that a link has to carry.
  if (navigator.userActivation?.hasBeenActive) tell({ layout: await pack(layout) });
}

async function start() {
  prepare();
  const asked = state.read();
  const source = new StoreSource(asked, showError);
  const [found] = await Promise.all([source.open(), loadStudio()]);
  if (!found.topics.length) throw new Error("There is no message in this window that could be shown.");
  const time = asked.time ?? source.start;
  const layouts = new Layouts(await chooseLayout(asked.layout, source), keepLayout);
  const factory = {
    id: SOURCE,
    type: "connection",
    displayName: "cassandra_ros",
    iconName: "Database",
    initialize: () => makePlayer(source, time),
  };
  // Else it would choose the layout that was shown last.
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
