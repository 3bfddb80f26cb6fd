# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A page of statements in SQL that end DuckDB, fill memory or disk, or never end."""

from __future__ import annotations

ENDLESS = "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r"

BAD_STATEMENTS = (
    # Parsers by recursion overflow their stack.
    "SELECT from_json('1', repeat('[', 30000) || '\"INT\"' || repeat(']', 30000))",
    "SELECT json_contains(repeat('[', 1000000) || repeat(']', 1000000), '1')",
    "SELECT json_valid(repeat('{\"a\":', 1000000) || '1' || repeat('}', 1000000))",
    "SELECT (repeat('[', 20000) || '1' || repeat(']', 20000))::JSON::VARIANT::VARCHAR",
    "SELECT json_structure(repeat('[', 30000) || repeat(']', 30000))",
    "SELECT json_merge_patch(repeat('{\"a\":', 30000) || '1' || repeat('}', 30000), '{}')",
    "SELECT (repeat('[', 200000) || repeat(']', 200000))::INT[]",
    f"SELECT {'(' * 3000}1{')' * 3000}",
    f"SELECT {'[' * 200}1{']' * 200}",
    f"SELECT 1{'::VARCHAR::INT' * 3000}",
    f"SELECT {'NOT ' * 10000}true",
    f"SELECT {'-' + ' -' * 10000}1",
    "SELECT " + "+".join(["1"] * 15000),
    # Memory that DuckDB does not count.
    "SELECT lpad('x', 2000000000, 'y')",
    "SELECT repeat('x', 1500000000)",
    "SELECT string_agg(repeat('x', 1000000), '') FROM range(3000)",
    "SELECT list(range(1000000)) FROM range(1000)",
    "SELECT array_to_string(range(300000000), ',')",
    "SELECT string_split(repeat('a,', 100000000), ',')",
    "SELECT regexp_extract_all(repeat('a', 100000000), '.')",
    "SELECT histogram(n) FROM range(300000000) t(n)",
    "SELECT bit_count(repeat('1', 400000000)::BIT)",
    "SELECT repeat('x', 5000000) FROM range(2000)",
    # Calls that do not notice an interrupt.
    "SELECT jaro_winkler_similarity(repeat('ab', 15000000), repeat('ba', 15000000))",
    "SELECT jaro_winkler_similarity(repeat('ab', 1500000), repeat('ba', 1500000))",
    "SELECT levenshtein(repeat('ab', 100000), repeat('ba', 100000))",
    "SELECT damerau_levenshtein(repeat('ab', 20000), repeat('ba', 20000))",
    "SELECT regexp_matches(repeat('a', 50000000), '(a?){500}a{500}b')",
    "SELECT regexp_replace(repeat('a', 30000000), '(a|a)*$', 'b', 'g')",
    # Without end, or nearly.
    ENDLESS,
    "WITH RECURSIVE r AS (SELECT 'x' AS t UNION ALL SELECT t || t FROM r) SELECT count(*) FROM r",
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT unnest([n, n]) FROM r) SELECT sum(n) FROM r",
    "SELECT count(*) FROM generate_series(TIMESTAMP '0001-01-01', TIMESTAMP '9999-01-01', "
    "INTERVAL 1 MICROSECOND)",
    "SELECT count(*) FROM range(1000000000) a, range(1000000000) b WHERE a.range < b.range",
    "SELECT * FROM range(100000000000)",
    # Disk.
    "SELECT * FROM range(400000000) t(n) ORDER BY hash(n)",
    "SELECT hash(n), count(*) FROM range(1000000000) t(n) GROUP BY ALL ORDER BY 2 DESC LIMIT 1",
    # Texts.
    f"SELECT {', '.join('?' * 20000)}",
    "SELECT '\ud800'",
    "SELECT '\0'",
    "SELECT " + "x" * 70000,
    f"SELECT {', '.join('1' for _ in range(20000))}",
    "SELECT * FROM " + ", ".join(f"range(2) t{n}" for n in range(300)),
    "SELECT " + " ".join(["CASE WHEN true THEN"] * 1500) + " 1 " + "END " * 1500,
)
