// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The layout of the Studio's panels: made for the existing topics, or read from the address. */

/** @typedef {{topic: string, type: string, messages: number, schema: any}} Topic */
/** @typedef {string | {direction: "row" | "column", first: any, second: any, splitPercentage: number}} Node */
/** @typedef {{layout?: Node, configById: Record<string, any>, [key: string]: any}} Layout */

/** @type {any} Classes of browsers that the TypeScript of Debian 12 does not know. */
const newer = window;

const TRANSFORMS = ["tf/tfMessage", "tf2_msgs/TFMessage"];
const MAPS = ["nav_msgs/OccupancyGrid"];
const CLOUDS = ["sensor_msgs/PointCloud2", "sensor_msgs/LaserScan", "velodyne_msgs/VelodyneScan"];
const SHAPES = [
  "visualization_msgs/Marker", "visualization_msgs/MarkerArray", "nav_msgs/Path",
  "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/PoseArray",
  "geometry_msgs/PolygonStamped",
];
const IMAGES = ["sensor_msgs/CompressedImage", "sensor_msgs/Image"];
const POSITIONS = ["sensor_msgs/NavSatFix"];
/** Types whose numbers are no measurements over time. */
const NO_CURVES = [...TRANSFORMS, ...MAPS, ...CLOUDS, ...SHAPES, ...IMAGES, "sensor_msgs/CameraInfo", "rosgraph_msgs/Log"];
/** An image of one pixel that is transparent: a map without it would ask other servers for tiles. */
const NO_TILES = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw==";
/** @type {[string, string[]][]} */
const NUMBERS = ["Float32", "Float64", "Int32", "UInt32", "Int16"].map((name) => [`std_msgs/${name}`, ["data"]]);
/**
 * Fields of each type that are drawn as curves; the first existing ones are used.
 * @type {Map<string, string[]>}
 */
const CURVES = new Map([
  ["nav_msgs/Odometry", ["twist.twist.linear.x", "twist.twist.angular.z"]],
  ["geometry_msgs/Twist", ["linear.x", "angular.z"]],
  ["geometry_msgs/TwistStamped", ["twist.linear.x", "twist.angular.z"]],
  ["sensor_msgs/Imu", ["linear_acceleration.x", "angular_velocity.z"]],
  ["sensor_msgs/BatteryState", ["percentage"]],
  ["sensor_msgs/JointState", ["position[:]"]],
  ["sensor_msgs/Range", ["range"]],
  ["sensor_msgs/NavSatFix", ["altitude"]],
  ...NUMBERS,
]);
const FLOATS = ["float32", "float64"];
const INTEGERS = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"];
const NARROW_PX = 700;
const MOST_IMAGES = 3;
const MOST_CURVES = 4;
const FOLLOWED_SEC = 30;
const MOST_CLOUDS = 6;
/** Maximum length of a layout in an address: servers refuse lines above 8 KB. */
const MOST_PACKED = 5000;

/**
 * Make a layout of what there is: a 3D panel of what has frames, cameras, a map of positions, curves of
 * numbers, and a raw message.
 * @param {Topic[]} topics Topics with something to show.
 * @param {boolean} following Whether curves show only the last played messages, because all are too many.
 * @returns {Layout}
 */
export function layoutOf(topics, following) {
  /** @type {Record<string, any>} */
  const configById = {};
  const space = addSpace(topics, configById);
  const others = [...addCameras(topics, configById), ...addMap(topics, configById)];
  const texts = [...addCurves(topics, configById, following), ...addTexts(topics, configById)];
  // On a narrow page the panels beside 3D stand below it, and only the first of the texts.
  const narrow = innerWidth < NARROW_PX;
  if (narrow) texts.length = Math.min(1, texts.length);
  const beside = split(narrow || !space ? "row" : "column", others);
  const above = split(narrow ? "column" : "row", [space, beside], 68);
  return whole(split("column", [above, split("row", texts)], 68), configById);
}

/** @param {Node | undefined} layout @param {Record<string, any>} configById @returns {Layout} */
function whole(layout, configById) {
  return { layout, configById, globalVariables: {}, userNodes: {}, playbackConfig: { speed: 1 } };
}

/**
 * Put nodes side by side; the first gets `percent`, or all get the same.
 * @param {"row" | "column"} direction
 * @param {(Node | undefined)[]} nodes
 * @param {number} [percent]
 * @returns {Node | undefined}
 */
function split(direction, nodes, percent) {
  const [first, ...rest] = nodes.filter((node) => node !== undefined);
  if (!rest.length) return first;
  const second = split(direction, rest);
  return { direction, first, second, splitPercentage: percent ?? 100 / (rest.length + 1) };
}

/** @param {Topic[]} topics @param {string[]} types */
function ofTypes(topics, types) {
  return topics.filter((topic) => types.includes(topic.type));
}

/** @param {Topic[]} topics @param {Record<string, any>} configById */
function addSpace(topics, configById) {
  const drawn = [
    ...ofTypes(topics, MAPS), ...ofTypes(topics, CLOUDS).slice(0, MOST_CLOUDS), ...ofTypes(topics, SHAPES),
  ];
  if (!drawn.length && !ofTypes(topics, TRANSFORMS).length) return undefined;
  const visible = drawn.map((topic) => [topic.topic, drawing(topic)]);
  configById["3D!space"] = {
    // A robot alone is shown from nearer than a robot in a room.
    cameraState: { distance: drawn.length ? 15 : 5 },
    followMode: "follow-pose",
    topics: Object.fromEntries(visible),
    layers: { grid: GRID },
    scene: { transforms: drawn.length ? { axisScale: 3 } : { axisScale: 1.5, labelSize: 0.08 } },
    transforms: {},
    publish: {},
  };
  return "3D!space";
}

const GRID = {
  visible: true, frameLocked: true, label: "Grid", instanceId: "grid", layerId: "foxglove.Grid",
  size: 20, divisions: 20, lineWidth: 1, color: "#8a97a880", position: [0, 0, 0], rotation: [0, 0, 0], order: 1,
};

/** @param {Topic} topic */
function drawing(topic) {
  if (topic.type === "sensor_msgs/LaserScan") {
    return { visible: true, colorField: "range", colorMode: "flat", flatColor: "#ff5a36ff", pointSize: 4 };
  }
  return { visible: true };
}

/** @param {Topic[]} topics @param {Record<string, any>} configById @returns {Node[]} */
function addCameras(topics, configById) {
  // A camera publishes the same picture in several formats: the smallest one is enough.
  const cameras = new Map();
  for (const type of IMAGES) {
    for (const { topic: name } of ofTypes(topics, [type])) {
      const camera = name.replace(/\/(compressed|compressedDepth|theora)$/, "");
      if (!cameras.has(camera)) cameras.set(camera, name);
    }
  }
  return [...cameras.values()].slice(0, MOST_IMAGES).map((cameraTopic, index) => {
    const id = `ImageViewPanel!camera${index}`;
    configById[id] = { cameraTopic, enabledMarkerTopics: [], mode: "fit", synchronize: false, transformMarkers: false };
    return id;
  });
}

/** @param {Topic[]} topics @param {Record<string, any>} configById @returns {Node[]} */
function addMap(topics, configById) {
  if (!ofTypes(topics, POSITIONS).length) return [];
  configById["map!positions"] = { layer: "custom", customTileUrl: NO_TILES, zoomLevel: 19, disabledTopics: [],
    followTopic: "", topicColors: {} };
  return ["map!positions"];
}

/**
 * Return the paths of the numbers in a message, outside of arrays.
 * @param {Topic} topic
 * @param {string[]} types Types of the numbers.
 */
function numbersOf({ topic, schema }, types) {
  /** @type {(type: string, path: string) => string[]} */
  const within = (type, path) => schema.types[type].flatMap((/** @type {any} */ field) => {
    if (field.isConstant || field.isArray || field.type === "std_msgs/Header") return [];
    if (field.isComplex) return within(field.type, `${path}.${field.name}`);
    return types.includes(field.type) ? [`${path}.${field.name}`] : [];
  });
  return within(schema.root, topic);
}

/** @param {Topic[]} topics @param {Record<string, any>} configById @param {boolean} following @returns {Node[]} */
function addCurves(topics, configById, following) {
  const usual = [...CURVES].flatMap(([type, fields]) =>
    ofTypes(topics, [type]).flatMap((topic) => fields.map((field) => `${topic.topic}.${field}`)));
  const others = topics.filter((topic) => !NO_CURVES.includes(topic.type));
  const paths = [usual, ...[FLOATS, INTEGERS].map((types) => others.flatMap((topic) => numbersOf(topic, types)))]
    .find((each) => each.length);
  if (!paths) return [];
  configById["Plot!curves"] = {
    paths: paths.slice(0, MOST_CURVES).map((value) => ({ value, enabled: true, timestampMethod: "receiveTime" })),
    showXAxisLabels: true, showYAxisLabels: true, showLegend: true, legendDisplay: "top",
    showPlotValuesInLegend: false, isSynced: true, xAxisVal: "timestamp", sidebarDimension: 64,
    ...(following && { followingViewWidth: FOLLOWED_SEC }),
  };
  return ["Plot!curves"];
}

/** @param {Topic[]} topics @param {Record<string, any>} configById @returns {Node[]} */
function addTexts(topics, configById) {
  const large = [...IMAGES, ...MAPS, ...CLOUDS, ...TRANSFORMS];
  const told = [...ofTypes(topics, [...CURVES.keys()]), ...topics.filter((topic) => !large.includes(topic.type)),
    ...topics][0];
  const panels = [];
  if (told) {
    configById["RawMessages!text"] = { topicPath: told.topic, diffEnabled: false, diffMethod: "custom", diffTopicPath: "",
      showFullMessageForDiff: false };
    panels.push("RawMessages!text");
  }
  if (ofTypes(topics, ["rosgraph_msgs/Log"]).length) {
    configById["RosOut!log"] = { searchTerms: [], minLogLevel: 1 };
    panels.push("RosOut!log");
  }
  return panels;
}

/**
 * Write a layout for an address; '' = it is too large.
 * @param {Layout} layout
 * @returns {Promise<string>}
 */
export async function pack(layout) {
  const { CompressionStream } = newer;
  const { userNodes, ...rest } = layout;
  const bytes = await through(new CompressionStream("deflate-raw"), new TextEncoder().encode(JSON.stringify(rest)));
  let binary = "";
  for (const byte of bytes) binary += String.fromCharCode(byte);
  const text = btoa(binary).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return text.length > MOST_PACKED ? "" : text;
}

/**
 * Read a layout from an address. Scripts in it, which the Studio would run, are removed.
 * @param {string} text
 * @returns {Promise<Layout>}
 * @throws {Error} The text is no layout.
 */
export async function unpack(text) {
  const { DecompressionStream } = newer;
  try {
    const binary = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
    const bytes = await through(new DecompressionStream("deflate-raw"), Uint8Array.from(binary, (each) => each.charCodeAt(0)));
    const found = JSON.parse(new TextDecoder().decode(bytes));
    if (typeof found.configById !== "object" || found.configById === null) throw new TypeError("no panels");
    const { layout, configById, globalVariables, playbackConfig } = found;
    return { ...whole(layout, configById), globalVariables: globalVariables ?? {}, ...(playbackConfig && { playbackConfig }) };
  } catch (error) {
    const why = error instanceof Error ? error.message : String(error);
    throw new Error(`The address has a layout that cannot be read (${why}): the usual one is shown.`);
  }
}

/**
 * @param {ReadableWritablePair<Uint8Array, any>} transform
 * @param {BlobPart} bytes
 */
async function through(transform, bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(transform);
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
