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

VENV_PYTHON := .venv/bin/python
IN_WORKSPACE := source .ws/devel/setup.bash &&

# What the command line may set, as in make bench OF=viewer; the environment does not. ARGS are the
# options of the program that a target runs.
ALL :=
GRAMMAR :=
OF :=
PAGE :=
PYTHON :=
SCREENSHOTS :=

.PHONY: help setup demo test test-all campaign faults lint doc bench deb clean

help:
	@echo "make setup     install what is missing: packages, .venv, Cassandra's jars, Studio, workspace .ws"
	@echo "                 GRAMMAR=1         and write the tables of the query language's grammar, after a change of it"
	@echo "make demo      record, ask and export a real robot's topics, end to end"
	@echo "                 ARGS=--view       and let the viewer run, to look at it in a browser"
	@echo "                 ARGS=--nodes=3    on three nodes, of which one is killed"
	@echo "                 ARGS=--secure     with a login, over TLS"
	@echo "                 ARGS=--fleet      two robots that copy themselves home, see doc/fleet.md"
	@echo "make test      every promise once, on a real Cassandra and a real roscore: six to ten minutes"
	@echo "                 ARGS='-k name'    some tests; ARGS are the options of pytest"
	@echo "                 PYTHON=python3.8  under another Python, up to python3.13, with the reasons and numbers of"
	@echo "                                   the tests that cannot run there; also with test-all and campaign"
	@echo "make test-all  that, and what kills, cuts, waits, starts servers, browsers, installations: about half an hour"
	@echo "make campaign  the searches with many examples, and each fault ten times (hours)"
	@echo "make faults    the fault table: kill and cut, and account for each message (hours)"
	@echo "                 ARGS=--short      in minutes; also --only NAME, --messages N, --list"
	@echo "                 PAGE=1            fill the tables of doc/faults.md from the last run, and run nothing"
	@echo "make lint      ruff, mypy, tsc on viewing/web/, catkin_lint, make doc"
	@echo "make doc       the pages of doc/, as build/doc/index.html; a warning is an error"
	@echo "                 SCREENSHOTS=1     and first take the README's pictures of the viewer"
	@echo "make bench     measure beside rosbag, MCAP, SQLite and the bare driver (40 minutes)"
	@echo "                 ARGS='--size quick'  with small numbers (5 minutes)"
	@echo "                 PAGE=1            fill the tables of doc/performance.md from the last runs, and measure nothing"
	@echo "                 OF=formats        formats on messages of real bags: bytes on disk, time"
	@echo "                 OF=play           how late messages are played, beside rosbag play"
	@echo "                 OF=viewer         the viewer on a recording of a day, ten million messages"
	@echo "                 OF=copy           a copy into another keyspace beside export and import, and beside writing"
	@echo "                 OF=fleet          questions about 1 to 1,000 robots in one keyspace"
	@echo "                 OF=spark          Spark with one executor and with two; installs it into .venv (350 MB on disk)"
	@echo "                 OF=mechanisms     conversions of many messages together beside one by one"
	@echo "                 OF=trees ARGS='EARLIER LATER'  two checkouts"
	@echo "make deb       build/cassandra-ros_*.deb for Debian's own ROS 1 (needs what debian/control names)"
	@echo "make clean     remove what was built"
	@echo "                 ALL=1             and .venv"

setup:
	@bash requirements/setup.sh
	@$(if $(GRAMMAR),PYTHONPATH=src $(VENV_PYTHON) -c 'from cassandra_ros.query.tree.grammar import write_tables; write_tables()')

demo: setup
	@$(IN_WORKSPACE) $(VENV_PYTHON) examples/demo.py $(ARGS)

# Four workers on two cores: many tests wait for programs and for the server. What the tests need of
# the workspace under another Python comes from make setup; the rest is made for that Python.
ifdef PYTHON
PYTEST = $(VENV_PYTHON) test/other_python.py $(PYTHON) -n 3
else
PYTEST = $(IN_WORKSPACE) $(VENV_PYTHON) -m pytest -n 4 --durations=25
endif

test: setup
	@export CASSANDRA_ROS_SUITE=test && $(PYTEST) $(ARGS)

test-all: setup
	@export CASSANDRA_ROS_SUITE=all && $(PYTEST) $(ARGS)

# A search takes longer than pytest waits before it prints the stacks of running threads, which may
# crash the interpreter.
campaign: setup
	@export CASSANDRA_ROS_SUITE=campaign && $(PYTEST) -o faulthandler_timeout=0 $(ARGS)

faults: setup
	@$(IN_WORKSPACE) PYTHONPATH=test:$$PYTHONPATH $(VENV_PYTHON) -m faults$(if $(PAGE),.page) $(ARGS)

lint: setup doc
	$(VENV_PYTHON) -m ruff check .
	$(VENV_PYTHON) -m ruff format --check .
	$(VENV_PYTHON) -m mypy
	@if command -v tsc >/dev/null; then tsc --project src/cassandra_ros/viewing/web; else \
	  echo "lint: the types in viewing/web/ are not checked: there is no tsc (Debian's package node-typescript)"; fi
	@$(IN_WORKSPACE) .venv/bin/catkin_lint --strict -W2 $(LINT_OPTIONS) .ws/src/cassandra_ros

doc: setup
	@$(if $(SCREENSHOTS),$(IN_WORKSPACE) $(VENV_PYTHON) examples/screenshots.py $(ARGS))
	@$(IN_WORKSPACE) PYTHONPATH=src:$$PYTHONPATH $(VENV_PYTHON) doc/option_tables.py
	@$(IN_WORKSPACE) $(VENV_PYTHON) -m sphinx -q -W --keep-going -d build/doctrees doc build/doc
	@echo "doc: build/doc/index.html"

bench: setup
	@$(if $(filter spark,$(OF)),$(VENV_PYTHON) -m pip install -q --disable-pip-version-check -r requirements/spark.txt)
	@$(IN_WORKSPACE) $(VENV_PYTHON) benchmark/$(if $(PAGE),page,bench$(OF:%=_%)).py $(ARGS)

# From what is committed; with Debian's own programs, whatever comes first on PATH.
deb:
	@rm -rf build/debian && mkdir -p build/debian
	@git archive --prefix=cassandra-ros/ HEAD | tar -x -C build/debian
	@cd build/debian/cassandra-ros && env -u PYTHONPATH -u CMAKE_PREFIX_PATH -u ROS_PACKAGE_PATH \
	  PATH=/usr/sbin:/usr/bin:/sbin:/bin dpkg-buildpackage -b -us -uc >../log 2>&1 || { tail -n 30 ../log; exit 1; }
	@mv build/debian/*.deb build/ && rm -rf build/debian && ls build/*.deb

# The jars and the data under the ROS home stay: local_cassandra clear deletes the data.
clean:
	rm -rf .ws build .mypy_cache .pytest_cache .ruff_cache .hypothesis demo-output $(if $(ALL),.venv)
	find src scripts test benchmark examples -name __pycache__ -type d -prune -exec rm -rf {} +
