// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * A plane on a canvas: dragging moves it, the wheel zooms it, keys do both. It shows an image (a map)
 * and layers that other modules draw. Lengths are in metres, x to the right and y upwards.
 */

/** @typedef {{x: number, y: number}} Point */
/**
 * @typedef {object} Bounds
 * @property {number} left
 * @property {number} right
 * @property {number} bottom
 * @property {number} top
 */
/**
 * @typedef {object} Image
 * @property {CanvasImageSource} picture Its first row has the largest y.
 * @property {number} width Pixels.
 * @property {number} height Pixels.
 * @property {number} resolution Size of a pixel.
 * @property {number} x x of the lower left corner.
 * @property {number} y y of the lower left corner.
 * @property {number} yaw Radians, about that corner.
 * @property {string} [frame] Frame of the image.
 */
/**
 * A tool that is used instead of moving the plane; its functions get positions in metres.
 * @typedef {object} Tool
 * @property {(at: Point, event: PointerEvent) => void} down
 * @property {(at: Point, event: PointerEvent) => void} move While a button is down.
 * @property {(at: Point, event: PointerEvent) => void} up
 */
/** @typedef {(context: CanvasRenderingContext2D, view: MapView) => void} Layer */

const ZOOM = 1.2;
const LEAST_SCALE = 1e-3;
const MOST_SCALE = 1e4;
const STEP_PIXELS = 60;
const CLICK_PIXELS = 4;

export class MapView {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    /** Scale, pixels of the page per metre. */
    this.scale = 50;
    /** @type {Point} What is in the middle. */
    this.centre = { x: 0, y: 0 };
    /** @type {Image | null} */
    this.image = null;
    /** @type {Layer[]} Drawn over the image, in this order. */
    this.layers = [];
    /** @type {Tool | null} */
    this.tool = null;
    /** @type {(at: Point, event: PointerEvent) => void} Called for a click that moved nothing. */
    this.onClick = () => {};
    /** @type {(at: Point | null) => void} Called where the pointer is; null: it left. */
    this.onHover = () => {};
    /** @type {{x: number, y: number, moved: number} | null} */
    this.drag = null;
    this.waiting = false;
    this.listen();
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.moveTo(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", () => this.letGo());
    canvas.addEventListener("pointerleave", () => this.onHover(null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(ZOOM ** (-event.deltaY / (event.deltaMode ? 3 : 100)), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  get width() { return this.canvas.clientWidth; }

  get height() { return this.canvas.clientHeight; }

  /**
   * Return the position of a point on the canvas, pixels of the page.
   * @param {number} x
   * @param {number} y
   * @returns {Point}
   */
  toScreen(x, y) {
    return {
      x: (x - this.centre.x) * this.scale + this.width / 2,
      y: this.height / 2 - (y - this.centre.y) * this.scale,
    };
  }

  /**
   * Return the point at a pixel of the canvas.
   * @param {number} x
   * @param {number} y
   * @returns {Point}
   */
  toWorld(x, y) {
    return {
      x: (x - this.width / 2) / this.scale + this.centre.x,
      y: (this.height / 2 - y) / this.scale + this.centre.y,
    };
  }

  /**
   * Move and zoom so that the bounds are visible.
   * @param {Bounds} bounds
   */
  fit(bounds) {
    const across = Math.max(bounds.right - bounds.left, 1);
    const up = Math.max(bounds.top - bounds.bottom, 1);
    this.centre = { x: (bounds.left + bounds.right) / 2, y: (bounds.bottom + bounds.top) / 2 };
    this.setScale(0.92 * Math.min(this.width / across, this.height / up));
  }

  /** @param {number} scale */
  setScale(scale) {
    this.scale = Math.min(MOST_SCALE, Math.max(LEAST_SCALE, scale || 1));
    this.draw();
  }

  /**
   * Zoom about a pixel, which stays in place.
   * @param {number} factor
   * @param {number} [x]
   * @param {number} [y]
   */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const before = this.toWorld(x, y);
    this.setScale(this.scale * factor);
    const after = this.toWorld(x, y);
    this.centre = {
      x: this.centre.x + before.x - after.x,
      y: this.centre.y + before.y - after.y,
    };
    this.draw();
  }

  /**
   * @param {number} right Pixels.
   * @param {number} down Pixels.
   */
  pan(right, down) {
    this.centre = { x: this.centre.x - right / this.scale, y: this.centre.y + down / this.scale };
    this.draw();
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (event.button !== 0) return;
    this.canvas.focus();
    this.canvas.setPointerCapture(event.pointerId);
    this.drag = { x: event.offsetX, y: event.offsetY, moved: 0 };
    if (this.tool) this.tool.down(this.toWorld(event.offsetX, event.offsetY), event);
    else this.canvas.classList.add("dragging");
  }

  /** @param {PointerEvent} event */
  moveTo(event) {
    const at = this.toWorld(event.offsetX, event.offsetY);
    this.onHover(at);
    const { drag } = this;
    if (!drag) return;
    const [right, down] = [event.offsetX - drag.x, event.offsetY - drag.y];
    drag.x = event.offsetX;
    drag.y = event.offsetY;
    drag.moved += Math.hypot(right, down);
    if (this.tool) this.tool.move(at, event);
    else this.pan(right, down);
  }

  /** @param {PointerEvent} event */
  up(event) {
    const { drag } = this;
    this.letGo();
    if (!drag) return;
    const at = this.toWorld(event.offsetX, event.offsetY);
    if (this.tool) this.tool.up(at, event);
    else if (drag.moved < CLICK_PIXELS) this.onClick(at, event);
  }

  letGo() {
    this.drag = null;
    this.canvas.classList.remove("dragging");
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const moves = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const move = moves[/** @type {keyof typeof moves} */ (event.key)];
    if (move) this.pan(move[0] * STEP_PIXELS, move[1] * STEP_PIXELS);
    else if (event.key === "+" || event.key === "=") this.zoom(ZOOM);
    else if (event.key === "-") this.zoom(1 / ZOOM);
    else return;
    event.preventDefault();
  }

  /** Draw once with the next frame, also after several calls. */
  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.drawNow();
    });
  }

  drawNow() {
    const { canvas, width, height } = this;
    const dots = window.devicePixelRatio || 1;
    const size = [Math.round(width * dots), Math.round(height * dots)];
    if (canvas.width !== size[0]) canvas.width = size[0];
    if (canvas.height !== size[1]) canvas.height = size[1];
    const context = canvas.getContext("2d");
    if (!context || !width || !height) return;
    context.setTransform(dots, 0, 0, dots, 0, 0);
    context.clearRect(0, 0, width, height);
    if (this.image) this.drawImage(context, this.image);
    this.drawLines(context);
    for (const layer of this.layers) {
      context.save();
      layer(context, this);
      context.restore();
    }
    this.drawBar(context);
    canvas.dataset.scale = String(this.scale);
    canvas.dataset.centre = `${this.centre.x},${this.centre.y}`;
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {Image} image
   */
  drawImage(context, image) {
    const corner = this.toScreen(image.x, image.y);
    const pixel = this.scale * image.resolution;
    context.save();
    context.translate(corner.x, corner.y);
    context.rotate(-image.yaw);
    context.scale(pixel, pixel);
    context.imageSmoothingEnabled = pixel < 1;
    context.drawImage(image.picture, 0, -image.height);
    context.restore();
  }

  /** @param {CanvasRenderingContext2D} context */
  drawLines(context) {
    const step = rounded(80 / this.scale);
    const [low, high] = [this.toWorld(0, this.height), this.toWorld(this.width, 0)];
    context.lineWidth = 1;
    context.globalAlpha = 0.5;
    for (let n = Math.ceil(low.x / step); n * step <= high.x; n += 1) {
      context.strokeStyle = colour(n ? "--line" : "--muted");
      line(context, this.toScreen(n * step, high.y), this.toScreen(n * step, low.y));
    }
    for (let n = Math.ceil(low.y / step); n * step <= high.y; n += 1) {
      context.strokeStyle = colour(n ? "--line" : "--muted");
      line(context, this.toScreen(low.x, n * step), this.toScreen(high.x, n * step));
    }
    context.globalAlpha = 1;
  }

  /** @param {CanvasRenderingContext2D} context */
  drawBar(context) {
    const step = rounded(80 / this.scale);
    const [left, bottom, long] = [16, this.height - 16, step * this.scale];
    context.fillStyle = colour("--surface");
    context.fillRect(left - 6, bottom - 20, long + 12, 27);
    context.strokeStyle = context.fillStyle = colour("--text");
    context.lineWidth = 2;
    line(context, { x: left, y: bottom }, { x: left + long, y: bottom });
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(metres(step), left + long / 2, bottom - 6);
  }
}

/**
 * Return a colour of the page's style.
 * @param {string} name As --data.
 */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/**
 * Write a length for people.
 * @param {number} length
 */
export function metres(length) {
  if (length >= 1000) return `${length / 1000} km`;
  if (length >= 1) return `${length} m`;
  return length >= 0.01 ? `${Number((length * 100).toPrecision(3))} cm` : `${Number((length * 1000).toPrecision(3))} mm`;
}

/** @param {number} length Rounded up to 1, 2 or 5 times a power of ten. */
function rounded(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return ([1, 2, 5].find((n) => n * power >= length) ?? 10) * power;
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Point} from
 * @param {Point} to
 */
function line(context, from, to) {
  context.beginPath();
  context.moveTo(Math.round(from.x) + 0.5, Math.round(from.y) + 0.5);
  context.lineTo(Math.round(to.x) + 0.5, Math.round(to.y) + 0.5);
  context.stroke();
}
