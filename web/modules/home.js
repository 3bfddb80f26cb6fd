// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Home: what is stored, and when. */

import * as page from "./page.js";

page.start("Home");
