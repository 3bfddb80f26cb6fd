# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
#
# make setup: install what is missing, say each step, skip what is there. Run from the checkout's
# root. Steps: Debian packages, .venv, Cassandra's jars, the Studio, catkin workspace .ws.
set -euo pipefail

root=$(pwd -P)
venv=$root/.venv
workspace=$root/.ws

say() { printf 'setup: %s\n' "$*"; }
die() { printf 'setup: %s\n' "$*" >&2; exit 1; }

# Run a command again when it fails: downloads do.
retry() {
  local attempt
  for attempt in 1 2 3 4; do
    "$@" </dev/null && return 0
    [ "$attempt" -lt 4 ] && say "attempt $attempt of 4 failed, again in $((attempt * 5)) s: $*" && sleep $((attempt * 5))
  done
  return 1
}

digest() { sha256sum | cut -d' ' -f1; }

# --- 0: not in somebody's catkin workspace ---------------------------------------------------

enclosing_workspace() {
  local folder
  folder=$(dirname "$root")
  while [ "$folder" != / ]; do
    if [ -e "$folder/.catkin_workspace" ] || [ -d "$folder/.catkin_tools" ]; then
      printf '%s' "$folder"
      return
    fi
    if [ -e "$folder/CMakeLists.txt" ] && grep -q 'catkin_workspace()' "$folder/CMakeLists.txt"; then
      dirname "$folder"
      return
    fi
    folder=$(dirname "$folder")
  done
}

stop_in_workspace() {
  local theirs
  theirs=$(enclosing_workspace)
  [ -n "$theirs" ] || return 0
  cat >&2 <<TEXT
setup: this checkout lies in the catkin workspace $theirs;
setup: a workspace of its own inside would give every program twice. Build it there, with the
setup: Python of a venv that has what requirements/runtime.txt names:
  /usr/bin/python3 -m venv --system-site-packages ~/cassandra_ros_venv
  ~/cassandra_ros_venv/bin/pip install -r $root/requirements/runtime.txt
  cd $theirs && catkin_make -DPYTHON_EXECUTABLE=\$HOME/cassandra_ros_venv/bin/python
TEXT
  exit 1
}

# --- 1: packages of the distribution ---------------------------------------------------------

package_list() {
  # A compiler because catkin's CMake asks for one.
  echo gcc g++ cmake python3-venv
  if [ -d /opt/ros/noetic ]; then
    echo ros-noetic-ros-base ros-noetic-rostest ros-noetic-tf ros-noetic-tf2-msgs ros-noetic-tf2-py
    echo ros-noetic-{diagnostic,geometry,std}-msgs ros-noetic-std-srvs
  else
    # ROS base; rosrun, rostest and tf beside it, for the metapackages leave them out.
    echo ros-core-python-dev rosbash python3-rostest python3-tf python3-tf2 python3-tf2-msgs ros-tf2-msgs
    # What the services send, for Python and for the build.
    echo python3-{diagnostic,geometry,std}-msgs ros-{diagnostic,geometry,std}-msgs lib{geometry,std}-msgs-dev
    echo python3-std-srvs ros-std-srvs
  fi
}

optional_package_list() {
  # Plots in the viewer.
  echo libjs-dygraphs
  # Only the tests need the others: what brings message types, of which they send more than 200,
  # zsh, in which they press Tab, curl, as the tutorial has it, openssl, which makes certificates,
  # a browser, in which they look at the viewer, and TypeScript, by which make lint checks the types
  # of the viewer's pages.
  echo zsh curl openssl
  if [ "$(. /etc/os-release && echo "$ID")" = debian ]; then
    echo chromium chromium-driver node-typescript
  fi
  local common=(actionlib map move-base nav pcl rosgraph sensor shape stereo trajectory visualization)
  if [ -d /opt/ros/noetic ]; then
    printf 'ros-noetic-%s-msgs ' "${common[@]}" moveit
    echo ros-noetic-{actionlib,bond,dynamic-reconfigure,roscpp}
  else
    printf 'python3-%s-msgs ' "${common[@]}"
    printf 'ros-%s-msgs ' "${common[@]}"
    echo python3-{actionlib,bond,dynamic-reconfigure,opencv-apps,roscpp-msg}
  fi
}

print_missing() {
  local package installed
  # One question for all: each reads the whole list of dpkg. It fails at a package that it does not know.
  installed=$(dpkg-query -W -f '\n${db:Status-Status} ${Package} ' "$@" 2>/dev/null || true)
  for package in "$@"; do
    [[ $installed == *$'\n'"installed $package "* ]] || echo "$package"
  done
}

# Whether a Java 17 is there without .venv, where local_cassandra looks for it, and Maven.
# No grep -q in a pipe: it ends early, and pipefail takes that for a failure of the first program.
has_java_and_maven() {
  local java
  command -v mvn >/dev/null || return 1
  [ -z "$(print_missing openjdk-17-jre-headless)" ] && return
  for java in "${JAVA_HOME:-/nowhere}/bin/java" "$(command -v java)" /usr/lib/jvm/*17*/bin/java; do
    [ -x "$java" ] && "$java" -version 2>&1 | grep 'version "17' >/dev/null && return
  done
  return 1
}

# Java without a display, and Maven for the jars, where the distribution has this Java: its updates
# come with the others of the system. Else requirements/java.txt has both, but that Java cannot run
# nodetool, which a Java of any version can.
java_package_list() {
  if has_java_and_maven; then
    return
  elif apt-cache policy openjdk-17-jre-headless | grep 'Candidate: [0-9]' >/dev/null; then
    print_missing openjdk-17-jre-headless maven
  else
    print_missing default-jre-headless
  fi
}

install_packages() {
  local needed optional as_root=()
  command -v dpkg-query >/dev/null ||
    die "this is no Debian or Ubuntu: doc/install.md says what to do with a ROS of another origin"
  read -r -a needed <<<"$(print_missing $(package_list) | tr '\n' ' ')"
  read -r -a optional <<<"$(print_missing $(optional_package_list) | tr '\n' ' ')"
  if [ "$(id -u)" != 0 ]; then
    # Without a terminal sudo can ask nobody for a password.
    if command -v sudo >/dev/null && { sudo -n true 2>/dev/null || { [ -t 0 ] && [ -t 2 ]; }; }; then
      as_root=(sudo)
    elif [ ${#needed[@]} != 0 ]; then
      say "packages are missing and only root may install them; run this, then make setup again:" >&2
      printf "  sudo sh -c 'apt-get update && apt-get install --no-install-recommends %s'\n" "${needed[*]}" >&2
      exit 1
    elif [ ${#optional[@]} != 0 ]; then
      say "packages: what is needed is installed; tests and the viewer's plots lack, and only root can: apt-get install --no-install-recommends ${optional[*]}"
      return
    fi
  fi
  if [ $((${#needed[@]} + ${#optional[@]})) = 0 ]; then
    say "packages: all are installed, skipped"
    return
  fi
  local apt=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -y -o Dpkg::Use-Pty=0)
  local log=$workspace/packages.log
  mkdir -p "$workspace"
  retry "${apt[@]}" update >"$log" 2>&1 || die_of "$log"
  needed+=("${optional[@]}" $(java_package_list))
  say "packages: installing ${needed[*]}"
  say "packages: this takes a few minutes; its output goes to .ws/packages.log"
  retry "${apt[@]}" install --no-install-recommends "${needed[@]}" >>"$log" 2>&1 || die_of "$log"
}

die_of() {
  tail -n 30 "$1" >&2
  die "apt-get failed; its last lines are above"
}

# --- 2: the venv -----------------------------------------------------------------------------

make_venv() {
  local stamp=$venv/.setup wanted files=(requirements/dev.txt)
  has_java_and_maven || files+=(requirements/java.txt)
  # Its path belongs to it: the programs of a venv that was moved still name the old place.
  wanted=$( { echo "$venv"; /usr/bin/python3 --version; echo "${files[*]}"; cat requirements/*.txt; } | digest)
  if [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ] && "$venv/bin/python" -S -c '' 2>/dev/null; then
    say "python: .venv has what ${files[*]} names, skipped"
    return
  fi
  if ! usable_venv; then
    say "python: making .venv from /usr/bin/python3"
    rm -rf "$venv"
    /usr/bin/python3 -m venv --system-site-packages "$venv"
  fi
  say "python: installing ${files[*]} into .venv"
  retry env PYTHONPATH= "$venv/bin/python" -m pip install -q --disable-pip-version-check "${files[@]/#/-r}" ||
    die "pip could not install ${files[*]}; see above"
  echo "$wanted" >"$stamp"
}

# Whether .venv is one of the system's Python 3 and of this place.
usable_venv() {
  grep -q 'include-system-site-packages = true' "$venv/pyvenv.cfg" 2>/dev/null &&
    [ "$("$venv/bin/python" -c 'import sys; print(sys.prefix, sys.base_prefix, "%d.%d" % sys.version_info[:2])' 2>/dev/null)" = \
      "$venv /usr $(/usr/bin/python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])')" ] &&
    grep -q "^VIRTUAL_ENV=.*$venv" "$venv/bin/activate" 2>/dev/null
}

# --- 3: Cassandra's jars ---------------------------------------------------------------------

install_jars() {
  PYTHONPATH=src "$venv/bin/python" scripts/local_cassandra install </dev/null | sed -u 's/^/setup: cassandra: /'
}

# --- 4: the Studio, for the viewer's page Look ----------------------------------------------

install_studio() {
  PYTHONPATH=src "$venv/bin/python" scripts/viewer --install-studio </dev/null 2>&1 | sed -u 's/^/setup: studio: /' ||
    say "studio: all but the viewer's page Look works without it; make setup tries again"
}

# --- 5: the catkin workspace -----------------------------------------------------------------

make_workspace() {
  local package=$workspace/src/cassandra_ros stamp=$workspace/.setup wanted item
  local items=(CMakeLists.txt package.xml setup.py requirements src scripts msg srv launch config examples test)
  mkdir -p "$package"
  find "$package" -maxdepth 1 -xtype l -delete # links to what an earlier checkout had
  for item in "${items[@]}"; do
    # One link per item: rosrun searches the package's folder, and .ws must not be in it.
    if [ -e "$root/$item" ] && [ "$(readlink "$package/$item")" != "../../../$item" ]; then
      ln -sfn "../../../$item" "$package/$item"
    fi
  done
  wanted=$( {
    echo "$root"
    "$venv/bin/python" --version
    # What lies below this workspace; a shell that has sourced it names itself as well.
    tr : '\n' <<<"${CMAKE_PREFIX_PATH:-}" | grep -vxF -e "$workspace/devel" -e "" || true
    ls scripts
    ls "$package"
    cat CMakeLists.txt package.xml setup.py
    find msg srv -type f | LC_ALL=C sort | xargs -d '\n' awk 'FNR == 1 { print FILENAME } 1'
    find -L "$package/test" -name '*.test' | LC_ALL=C sort
  } | digest)
  if [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ] && [ -e "$workspace/devel/setup.bash" ]; then
    say "workspace: .ws is built, skipped"
    return
  fi
  say "workspace: building .ws with catkin_make"
  rm -rf "$workspace/build" "$workspace/devel"
  if ! catkin_make -C "$workspace" -DPYTHON_EXECUTABLE="$venv/bin/python" >"$workspace/build.log" 2>&1 </dev/null; then
    tail -n 40 "$workspace/build.log" >&2
    die "catkin_make failed; everything it said is in .ws/build.log"
  fi
  echo "$wanted" >"$stamp"
}

stop_in_workspace
# One set-up at a time; the lock ends with this script.
exec 9<Makefile
flock 9
install_packages
if [ -f /opt/ros/noetic/setup.bash ]; then
  set +u
  # shellcheck disable=SC1091
  source /opt/ros/noetic/setup.bash
  set -u
  say "ros: using /opt/ros/noetic"
fi
make_venv
install_jars
install_studio
make_workspace
say "done; in a shell: source .ws/devel/setup.bash"
