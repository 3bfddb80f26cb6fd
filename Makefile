# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
# make demo and make test are all that a fresh machine needs; each sets up what is missing.

SHELL := /bin/bash
.DEFAULT_GOAL := help

# The same messages and file names whatever the caller's locale is.
export LC_ALL := C.UTF-8
# Nodes of demo and tests find each other without a resolvable host name.
unexport ROS_HOSTNAME
export ROS_IP := 127.0.0.1
# Each of the many processes of the tests would compile all of the package anew.
unexport PYTHONDONTWRITEBYTECODE

PYTHON := .venv/bin/python
IN_WORKSPACE := source .ws/devel/setup.bash &&

.PHONY: help setup grammar demo viewer screenshots test test-all test-python campaign faults faults-page lint doc bench bench-quick bench-page bench-formats bench-play bench-viewer bench-fleet bench-copy bench-spark bench-trees bench-mechanisms deb clean distclean

help:
	@echo "make setup          install what is missing: packages, .venv, Cassandra's jars, Studio, workspace .ws"
	@echo "make demo           record, ask and export a real robot's topics, end to end"
	@echo "                    (ARGS=--view: and let the viewer run, to look at it in a browser;"
	@echo "                    ARGS=--nodes=3: on three nodes, of which one is killed; ARGS=--secure;"
	@echo "                    ARGS=--fleet: two robots that copy themselves home, see doc/fleet.md)"
	@echo "make viewer         fetch the Studio for the viewer's page Look, and say how to start it"
	@echo "make grammar        keep the tables of the query language's grammar anew, after a change of it"
	@echo "make screenshots    take the README's pictures of the viewer anew"
	@echo "make test           every promise once, on a real Cassandra and a real roscore: 10 to 12 minutes"
	@echo "                    (ARGS='-k name')"
	@echo "make test-all       that, and what kills, cuts, waits, starts servers, browsers, installations: over half an hour"
	@echo "make test-python    the tests under another Python (PYTHON=python3.8, the default, to python3.13),"
	@echo "                    with the reasons and numbers of those that cannot run there"
	@echo "make campaign       the searches with many examples, and each fault ten times (hours)"
	@echo "make faults         the fault table: kill and cut, and account for each message (hours;"
	@echo "                    ARGS='--short' minutes, --only NAME, --messages N, --list)"
	@echo "make faults-page    fill the tables of doc/faults.md from the last make faults"
	@echo "make lint           ruff, mypy, tsc on viewing/web/, catkin_lint, make doc"
	@echo "make doc            the pages of doc/, as build/doc/index.html; a warning is an error"
	@echo "make bench          measure beside rosbag, MCAP, SQLite and the bare driver (40 minutes)"
	@echo "make bench-quick    the same with small numbers (5 minutes)"
	@echo "make bench-page     fill the tables of doc/performance.md from the last make bench, bench-viewer"
	@echo "make bench-formats  measure formats on messages of real bags: bytes on disk, time"
	@echo "make bench-play     measure how late messages are played, beside rosbag play"
	@echo "make bench-viewer   measure the viewer on a recording of a day, ten million messages"
	@echo "make bench-copy     measure a copy into another keyspace beside export and import, and beside writing"
	@echo "make bench-fleet    measure questions about 1 to 1,000 robots in one keyspace (ARGS=\"--robots 1 100 --topics 2\")"
	@echo "make bench-spark    install Spark into .venv (350 MB on disk), and measure it with one executor and with two"
	@echo "make bench-trees    compare two checkouts: ARGS=\"EARLIER LATER\""
	@echo "make bench-mechanisms  compare conversions of many messages together with one by one"
	@echo "make deb            build/cassandra-ros_*.deb for Debian's own ROS 1 (needs what debian/control names)"
	@echo "make clean          remove what was built; make distclean: also .venv"

setup:
	@bash requirements/setup.sh

grammar:
	@PYTHONPATH=src $(PYTHON) -c 'from cassandra_ros.query.tree.grammar import write_tables; write_tables()'

demo: setup
	@$(IN_WORKSPACE) $(PYTHON) examples/demo.py $(ARGS)

viewer: setup
	@PYTHONPATH=src $(PYTHON) scripts/viewer --install-studio
	@echo "now, in a shell that has sourced .ws/devel/setup.bash: rosrun cassandra_ros viewer"

screenshots: setup
	@$(IN_WORKSPACE) $(PYTHON) examples/screenshots.py $(ARGS)

# Four workers on two cores: many tests wait for programs and for the server.
PYTEST = $(PYTHON) -m pytest -n 4 --durations=25

test: setup
	@$(IN_WORKSPACE) CASSANDRA_ROS_SUITE=test $(PYTEST) $(ARGS)

test-all: setup
	@$(IN_WORKSPACE) CASSANDRA_ROS_SUITE=all $(PYTEST) $(ARGS)

# What the tests need of the workspace comes from make setup; the rest is made for that Python.
test-python: PYTHON = python3.8
test-python: setup
	@.venv/bin/python test/other_python.py $(PYTHON) -n 3 $(ARGS)

# A search takes longer than pytest waits before it prints the stacks of running threads, which may
# crash the interpreter.
campaign: setup
	@$(IN_WORKSPACE) CASSANDRA_ROS_SUITE=campaign $(PYTEST) -o faulthandler_timeout=0 $(ARGS)

faults: setup
	@$(IN_WORKSPACE) PYTHONPATH=test:$$PYTHONPATH $(PYTHON) -m faults $(ARGS)

faults-page: setup
	@$(IN_WORKSPACE) PYTHONPATH=test:$$PYTHONPATH $(PYTHON) -m faults.page $(ARGS)

lint: setup doc
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	@if command -v tsc >/dev/null; then tsc --project src/cassandra_ros/viewing/web; else \
	  echo "lint: the types in viewing/web/ are not checked: there is no tsc (Debian's package node-typescript)"; fi
	@$(IN_WORKSPACE) .venv/bin/catkin_lint --strict -W2 $(LINT_OPTIONS) .ws/src/cassandra_ros

doc: setup
	@$(IN_WORKSPACE) $(PYTHON) -m sphinx -q -W --keep-going -d build/doctrees doc build/doc
	@echo "doc: build/doc/index.html"

bench: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench.py $(ARGS)

bench-quick: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench.py --size quick $(ARGS)

bench-page: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/page.py $(ARGS)

bench-formats: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_formats.py $(ARGS)

bench-play: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_play.py $(ARGS)

bench-viewer: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_viewer.py $(ARGS)

bench-fleet: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_fleet.py $(ARGS)

bench-copy: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_copy.py $(ARGS)

bench-spark: setup
	@$(PYTHON) -m pip install -q --disable-pip-version-check -r requirements/spark.txt
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_spark.py $(ARGS)

bench-trees: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_trees.py $(ARGS)

bench-mechanisms: setup
	@$(IN_WORKSPACE) $(PYTHON) benchmark/bench_mechanisms.py $(ARGS)

# From what is committed; with Debian's own programs, whatever comes first on PATH.
deb:
	@rm -rf build/debian && mkdir -p build/debian
	@git archive --prefix=cassandra-ros/ HEAD | tar -x -C build/debian
	@cd build/debian/cassandra-ros && env -u PYTHONPATH -u CMAKE_PREFIX_PATH -u ROS_PACKAGE_PATH \
	  PATH=/usr/sbin:/usr/bin:/sbin:/bin dpkg-buildpackage -b -us -uc >../log 2>&1 || { tail -n 30 ../log; exit 1; }
	@mv build/debian/*.deb build/ && rm -rf build/debian && ls build/*.deb

clean:
	rm -rf .ws build .mypy_cache .pytest_cache .ruff_cache .hypothesis demo-output
	find src scripts test benchmark examples -name __pycache__ -type d -prune -exec rm -rf {} +

# The jars and the data under the ROS home stay: local_cassandra clear deletes the data.
distclean: clean
	rm -rf .venv
