// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The Studio's storage in this browser: its settings, and the layouts that the user saved. */

const PREFIX = "cassandra_ros.studio.";
/** Id of the layout in the address, which is not stored in the browser. */
export const SHOWN = "cassandra_ros";

/**
 * Set the Studio's own settings if it has none yet: the panels use the whole page, without hints for
 * new users.
 */
export function prepare() {
  const kept = {
    "fox.workspace": { state: { sidebarItem: null }, version: 0 },
    "studio.profile-data": { onboarding: { settingsTooltipShownForPanelTypes: ["3D"] } },
  };
  for (const [key, value] of Object.entries(kept)) {
    if (localStorage.getItem(key) === null) localStorage.setItem(key, JSON.stringify(value));
  }
}

/** Settings that differ from the Studio's defaults: no questions to the user, nothing sent elsewhere. */
const DEFAULTS = {
  "colorScheme": "system",
  "timezone": "UTC",
  "hideSignInPrompt": true,
  "launchPreference": "web",
  "ui.open-dialog-startup": false,
  "telemetry.telemetryEnabled": false,
  "telemetry.crashReportingEnabled": false,
  "updates.enabled": false,
};

/** The Studio's IAppConfiguration. */
export class Settings {
  constructor() {
    /** @type {Map<string, Set<(value: any) => void>>} */
    this.listeners = new Map();
  }

  /** @param {string} key */
  get(key) {
    const kept = localStorage.getItem(`${PREFIX}setting.${key}`);
    return kept === null ? /** @type {Record<string, any>} */ (DEFAULTS)[key] : JSON.parse(kept);
  }

  /** @param {string} key @param {unknown} value */
  async set(key, value) {
    if (value === undefined) localStorage.removeItem(`${PREFIX}setting.${key}`);
    else localStorage.setItem(`${PREFIX}setting.${key}`, JSON.stringify(value));
    for (const listener of this.listeners.get(key) ?? []) listener(value);
  }

  /** @param {string} key @param {(value: any) => void} listener */
  addChangeListener(key, listener) {
    if (!this.listeners.has(key)) this.listeners.set(key, new Set());
    this.listeners.get(key)?.add(listener);
  }

  /** @param {string} key @param {(value: any) => void} listener */
  removeChangeListener(key, listener) {
    this.listeners.get(key)?.delete(listener);
  }
}

/** The Studio's ILayoutStorage. */
export class Layouts {
  /**
   * @param {any} data First layout.
   * @param {(data: any) => void} onChange Called with each layout that the user changed.
   */
  constructor(data, onChange) {
    this.shown = {
      id: SHOWN, name: "Layout of the address", permission: "CREATOR_WRITE",
      baseline: { data, savedAt: new Date().toISOString() }, working: undefined, syncInfo: undefined,
    };
    this.onChange = onChange;
  }

  /** @param {string} namespace */
  async list(namespace) {
    const keys = Object.keys(localStorage).filter((key) => key.startsWith(place(namespace, "")));
    return [this.shown, ...keys.map((key) => JSON.parse(localStorage.getItem(key) ?? "null"))];
  }

  /** @param {string} namespace @param {string} id */
  async get(namespace, id) {
    if (id === SHOWN) return this.shown;
    const kept = localStorage.getItem(place(namespace, id));
    return kept === null ? undefined : JSON.parse(kept);
  }

  /** @param {string} namespace @param {any} layout */
  async put(namespace, layout) {
    if (layout.id === SHOWN) {
      this.shown = layout;
      this.onChange(layout.working?.data ?? layout.baseline.data);
    } else {
      localStorage.setItem(place(namespace, layout.id), JSON.stringify(layout));
    }
    return layout;
  }

  /** @param {string} namespace @param {string} id */
  async delete(namespace, id) {
    localStorage.removeItem(place(namespace, id));
  }

  /** Without a login there is one namespace. */
  async importLayouts() {}
}

/** @param {string} namespace @param {string} id */
function place(namespace, id) {
  return `${PREFIX}layout.${namespace}.${id}`;
}
