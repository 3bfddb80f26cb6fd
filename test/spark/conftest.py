# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Spark for the tests: PySpark, which is large, is installed for them alone, and once."""

from __future__ import annotations

import fcntl
import os
import sys
import sysconfig
from pathlib import Path

import pytest
from conftest import ROOT, WORKSPACE
from other_python import once, run

FOLDER = WORKSPACE / "spark"
REQUIREMENTS = ROOT / "requirements/spark.txt"


@pytest.fixture(scope="session")
def pyspark_folder():
    """The folder of PySpark's packages; what .venv has already is not installed there."""
    FOLDER.mkdir(exist_ok=True)
    with (FOLDER / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with once(FOLDER / "installed", sys.executable, REQUIREMENTS) as missing:
            if missing:
                pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q"]
                run([*pip, "--prefix", FOLDER, "-r", REQUIREMENTS])
    # make bench OF=spark installs it into .venv: then nothing is missing.
    return next(FOLDER.glob("lib/python3.*/site-packages"), Path(sysconfig.get_path("purelib")))


@pytest.fixture(scope="session")
def spark_env(pyspark_folder, ros_env):
    """Environment of a program that uses Spark."""
    from cassandra_ros.local_server.jars import find_java

    places = [str(pyspark_folder), str(ROOT / "src"), ros_env["PYTHONPATH"]]
    return dict(
        ros_env,
        PYTHONPATH=os.pathsep.join(places),
        PYSPARK_PYTHON=sys.executable,
        JAVA_HOME=os.path.dirname(os.path.dirname(os.path.realpath(find_java()))),
        SPARK_LOCAL_IP="127.0.0.1",
        CASSANDRA_ROS_CQLSHRC=os.devnull,
    )


@pytest.fixture(scope="module")
def spark(pyspark_folder, spark_env):
    """A Spark on this machine with two threads, whose executors are processes of Python."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in spark_env.items():
            patch.setenv(name, value)
        patch.syspath_prepend(str(pyspark_folder))
        from pyspark.sql import SparkSession

        options = {"spark.ui.enabled": "false", "spark.sql.shuffle.partitions": "2"}
        session = SparkSession.builder.master("local[2]").config(map=options).getOrCreate()
        gateway = session.sparkContext._gateway
        yield session
        session.stop()
        gateway.shutdown()
        gateway.proc.stdin.close()  # Spark's Java ends then
        gateway.proc.wait(180)
