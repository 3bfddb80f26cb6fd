// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Page Map: an occupancy grid of scans or point clouds, and the tracks of the robots. */

import { ask, get, isAbort } from "./api.js";
import { Lasso } from "./map_lasso.js";
import { MapView, colour, metres } from "./map_view.js";
import * as page from "./page.js";
import * as state from "./state.js";
import * as times from "./times.js";

const MAPPED = [
  "sensor_msgs/LaserScan",
  "sensor_msgs/MultiEchoLaserScan",
  "sensor_msgs/PointCloud2",
  "nav_msgs/OccupancyGrid",
];
const POSES = ["nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped"];
const FIXES = ["sensor_msgs/NavSatFix", ...["GeoPoseStamped", "GeoPointStamped", "GeoPose", "GeoPoint"].map((name) => `geographic_msgs/${name}`)];
const EARTH = "WGS84";
const DEGREE_METRES = 111195.08;
const RESOLUTIONS = [0.02, 0.05, 0.1, 0.2, 0.5];
const SCANS = [200, 1000, 5000, 20000];
const TRACK_COLOURS = ["--accent", "--run", "--mark", "--loss"];
const PICK_PIXELS = 12;

/**
 * The thinned track of a robot, in metres of the plane.
 * @typedef {object} Track
 * @property {string} node
 * @property {string} frame
 * @property {bigint[]} times
 * @property {number[]} x
 * @property {number[]} y
 * @property {boolean[]} joined Whether the way from the point before is known.
 */

/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));

page.start("Map");
export const view = new MapView(element("map"));
/** @type {Track[]} */
export let tracks = [];
/** Metres of the plane for x and y of the frame; on the Earth these are degrees, and shorter to the east. */
let unit = { x: 1, y: 1 };
/** @type {string[]} Topics that tell latitude and longitude. */
let fixes = [];
/** @type {AbortController | null} */
let going = null;
let asked = "";

/** The parameters of the map: the common state, and those of this page. */
export function question() {
  const { start, end, nodes, runs, others } = state.read();
  return { start, end, nodes, runs, topic: others.map ?? "", resolution: others.resolution ?? "", odom: others.odom ?? "", scans: others.scans ?? "" };
}

/**
 * @param {HTMLSelectElement} select
 * @param {string[][]} choices Pairs of value and text.
 * @param {string} name Name in the state; an empty value removes it.
 */
function fill(select, choices, name) {
  select.replaceChildren(...choices.map(([value, text]) => page.make("option", { value }, text)));
  const update = () => {
    const wanted = state.read().others[name] ?? "";
    if (wanted && ![...select.options].some((option) => option.value === wanted)) {
      select.append(page.make("option", { value: wanted }, wanted));
    }
    select.value = wanted;
  };
  select.addEventListener("change", () => state.write({ [name]: select.value || null }, { push: true }));
  state.onChange(update);
  update();
}

async function begin() {
  const [{ topics }, { runs, left_off: moreRuns }] = await Promise.all([
    get("/api/topics", { counts: "0" }),
    get("/api/runs", { counts: "0" }),
  ]);
  /** @param {string[]} types */
  const of = (types) => topics
    .filter((/** @type {any} */ topic) => topic.types.some((/** @type {string} */ type) => types.includes(type)))
    .sort((/** @type {any} */ a, /** @type {any} */ b) => types.indexOf(a.types[0]) - types.indexOf(b.types[0]))
    .map((/** @type {any} */ topic) => topic.topic);
  const mapped = of(MAPPED);
  fixes = of(FIXES);
  fill(element("map-topic"), [["", "nothing"], ...mapped.map((/** @type {string} */ name) => [name, name])], "map");
  fill(element("map-resolution"), [["", "5 cm"], ...RESOLUTIONS.filter((n) => n !== 0.05).map((n) => [String(n), metres(n)])], "resolution");
  fill(element("map-odom"), [["", "tf, or the best"], ...of([...POSES, ...FIXES]).map((/** @type {string} */ name) => [name, name])], "odom");
  fill(element("map-scans"), [["", "1000 messages"], ...SCANS.filter((n) => n !== 1000).map((n) => [String(n), `${n} messages`])], "scans");
  const nodes = [...new Set(runs.map((/** @type {any} */ run) => run.node))].sort();
  page.addSelection(element("map-selection"), {
    nodes: nodes.map((node) => ({ value: node, text: node || "(no name)" })).filter((node) => node.value),
    runs: runs.map((/** @type {any} */ run) => ({ value: String(run.id), text: run.run })),
    moreRuns,
  });
  if (!mapped.length) {
    tell("No topic of LaserScan, PointCloud2 or OccupancyGrid is stored: only the robots' tracks are drawn.");
  } else if (!("map" in state.read().others)) {
    state.write({ map: mapped[0] });
  }
  state.onChange(refresh);
  refresh();
}

/** Request the map if its parameters differ from the last request. */
function refresh() {
  const wanted = question();
  const text = JSON.stringify(wanted, (_, value) => (typeof value === "bigint" ? String(value) : value));
  if (text === asked) return;
  asked = text;
  going?.abort();
  going = new AbortController();
  const { signal } = going;
  page.clearErrors();
  view.canvas.dataset.state = "working";
  load(wanted, signal).then(
    () => done("drawn"),
    (error) => {
      if (isAbort(error)) return;
      page.showError(error);
      done("failed");
    },
  );
}

/** @param {string} how */
function done(how) {
  showAll();
  view.canvas.classList.remove("working");
  lasso.refresh();
  // Tests wait for it: it is set when the picture is drawn.
  requestAnimationFrame(() => requestAnimationFrame(() => { view.canvas.dataset.state = how; }));
}

/**
 * Request the map, then the tracks in its frame; without a map those in the usual frame.
 * @param {ReturnType<typeof question>} wanted
 * @param {AbortSignal} signal
 */
async function load(wanted, signal) {
  let failure = null;
  try {
    await loadMap(wanted, signal);
  } catch (error) {
    if (isAbort(error)) throw error;
    failure = error;
  }
  await loadTracks(wanted, signal);
  if (failure) throw failure;
}

/**
 * @param {ReturnType<typeof question>} wanted
 * @param {AbortSignal} signal
 */
async function loadMap(wanted, signal) {
  if (!wanted.topic || fixes.includes(wanted.odom)) {
    view.image = null;
    if (wanted.topic) tell(`${wanted.odom} tells latitude and longitude: the map is in another frame, and is not drawn.`);
    return;
  }
  view.canvas.classList.add("working");
  tell(`Making a map of ${wanted.topic} …`);
  try {
    const response = await ask("/api/map", wanted, { signal });
    const meta = JSON.parse(response.headers.get("X-Map") ?? "{}");
    view.image = { ...meta, picture: await createImageBitmap(await response.blob()) };
    tell(described(wanted.topic, meta));
    labelPoses(meta);
  } catch (error) {
    if (!isAbort(error)) {
      view.image = null;
      tell("");
    }
    throw error;
  }
}

/**
 * Return the topic whose poses a map was made with; "" = tf.
 * @param {any} meta
 */
function posesOf(meta) {
  return meta?.pose_topics?.find((/** @type {any} */ offer) => offer.taken)?.topic ?? "";
}

/**
 * Label the menu of poses: the topic that the map was made with, and for each topic the share of the
 * map's messages for which it has poses.
 * @param {any} meta
 */
function labelPoses(meta) {
  const offers = new Map(meta.pose_topics.map((/** @type {any} */ offer) => [offer.topic, offer.share]));
  for (const option of element("map-odom").options) {
    if (option.value) {
      const share = offers.get(option.value);
      option.text = share === undefined ? option.value : `${option.value} (${percent(share)})`;
      option.title = share === undefined ? "" : `Has poses for ${percent(share)} of the messages`;
    } else if (!question().odom) {
      option.text = `${posesOf(meta) || "tf"}, by itself`;
    }
  }
}

/**
 * Write a share; only 0 is written as 0 % and only 1 as 100 %.
 * @param {number} share
 */
function percent(share) {
  const rounded = Math.round(100 * share);
  return `${share > 0 && share < 1 ? Math.min(99, Math.max(1, rounded)) : rounded} %`;
}

/**
 * @param {string} topic
 * @param {any} meta
 */
function described(topic, meta) {
  const size = `${(meta.width * meta.resolution).toFixed(1)} × ${(meta.height * meta.resolution).toFixed(1)} m`;
  const parts = [`${topic} in frame ${meta.frame || "?"}: ${size}, cells of ${metres(Number(meta.resolution.toPrecision(6)))}`];
  parts.push(`${meta.used} messages, poses by ${meta.sources.join("; ")}`);
  if (meta.without_pose) parts.push(`${meta.without_pose} left out, because the pose of the sensor is unknown`);
  if (meta.received) parts.push(`${meta.received} placed by when they were received`);
  if (meta.unreadable) parts.push(`${meta.unreadable} unreadable`);
  return parts.join(" · ");
}

/**
 * @param {ReturnType<typeof question>} wanted
 * @param {AbortSignal} signal
 */
async function loadTracks(wanted, signal) {
  const { start, end, nodes, runs, odom } = wanted;
  const where = { start, end, nodes, runs, frame: view.image?.frame, robot: odom || posesOf(view.image) };
  const found = await get("/api/places", where, { signal }).catch((error) => {
    // A store without poses has no tracks; a stored map is shown anyway, with the reason.
    if (error?.status !== 404 && error?.status !== 400) throw error;
    const told = element("map-told").textContent;
    tell([told, `no tracks: ${error.message}`].filter(Boolean).join(" · "));
    return { tracks: [] };
  });
  const latitude = found.frame === EARTH ? found.tracks[0]?.y[0] ?? 0 : null;
  unit = latitude === null ? { x: 1, y: 1 } : { x: DEGREE_METRES * Math.cos((latitude * Math.PI) / 180), y: DEGREE_METRES };
  tracks = found.tracks.map((/** @type {any} */ track) => ({
    ...track,
    times: track.times.map(BigInt),
    x: track.x.map((/** @type {number} */ x) => x * unit.x),
    y: track.y.map((/** @type {number} */ y) => y * unit.y),
  }));
  view.canvas.dataset.points = String(tracks.reduce((sum, track) => sum + track.x.length, 0));
}

function showAll() {
  const bounds = { left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity };
  /** @param {number} x @param {number} y */
  const take = (x, y) => {
    bounds.left = Math.min(bounds.left, x);
    bounds.right = Math.max(bounds.right, x);
    bounds.bottom = Math.min(bounds.bottom, y);
    bounds.top = Math.max(bounds.top, y);
  };
  const { image } = view;
  if (image) {
    const [across, up] = [image.width * image.resolution, image.height * image.resolution];
    const [cos, sin] = [Math.cos(image.yaw), Math.sin(image.yaw)];
    for (const [u, v] of [[0, 0], [across, 0], [0, up], [across, up]]) {
      take(image.x + u * cos - v * sin, image.y + u * sin + v * cos);
    }
  }
  for (const track of tracks) track.x.forEach((x, n) => take(x, track.y[n]));
  if (bounds.left <= bounds.right) view.fit(bounds);
  else view.draw();
}

/** @type {import("./map_view.js").Layer} */
function drawTracks(context) {
  context.lineWidth = 2;
  context.lineJoin = "round";
  for (const [number, track] of tracks.entries()) {
    context.strokeStyle = colour(TRACK_COLOURS[number % TRACK_COLOURS.length]);
    context.beginPath();
    track.x.forEach((x, n) => {
      const at = view.toScreen(x, track.y[n]);
      if (n && track.joined?.[n] !== false) context.lineTo(at.x, at.y);
      else context.moveTo(at.x, at.y);
    });
    context.stroke();
  }
}

/**
 * Show the clicked time of a track, with a link to it.
 * @param {import("./map_view.js").Point} at
 */
function pick(at) {
  let best = { distance: PICK_PIXELS / view.scale, text: "", time: 0n };
  for (const track of tracks) {
    track.x.forEach((x, n) => {
      const distance = Math.hypot(x - at.x, track.y[n] - at.y);
      if (distance < best.distance) {
        best = { distance, time: track.times[n], text: `${track.node} ${times.shown(track.times[n])}` };
      }
    });
  }
  const place = element("map-picked");
  if (!best.text) {
    place.replaceChildren();
    return;
  }
  const look = page.make("a", { href: state.link("/look.html", { time: best.time }) }, "Show this time in Look");
  place.replaceChildren(page.make("div", { class: "panel row" }, best.text.trim(), look));
}

/** @param {string} text */
function tell(text) {
  element("map-told").textContent = text;
}

view.layers.push(drawTracks);
const places = {
  tracks: () => tracks,
  frame: () => view.image?.frame || tracks[0]?.frame || "",
  robot: () => question().odom || posesOf(view.image),
  unit: () => unit,
};
export const lasso = new Lasso(view, places, element("map-more"), element("map-near"));
view.onClick = pick;
view.onHover = (/** @type {import("./map_view.js").Point | null} */ at) => {
  const [x, y] = at ? [at.x / unit.x, at.y / unit.y] : [0, 0];
  const text = places.frame() === EARTH ? `latitude ${y.toFixed(6)}  longitude ${x.toFixed(6)}` : `x ${x.toFixed(2)}  y ${y.toFixed(2)} m`;
  element("map-cursor").textContent = at ? text : "";
};
view.canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
  if (event.key === "0") showAll();
});
page.takeKeys(view.canvas);
element("map-fit").addEventListener("click", showAll);
element("map-tools").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
begin().catch(page.showError);
