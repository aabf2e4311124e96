#!/bin/sh
# Builds the messages against the wheels of another distribution of ROS 2, such as kilted, and runs a preset with them.
# Usage: try_ros.sh PYTHON DISTRIBUTION
set -eu
python=$1
distribution=$2
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
unset PYTHONPATH

"$python" -m venv "$place"
pip="$place/bin/pip --disable-pip-version-check --quiet"

# What Jazzy builds with, without the versions, which are Jazzy's.
requires=$("$place/bin/python" -c 'import re, sys, tomllib
for one in tomllib.load(open("msg_defs/pyproject.toml", "rb"))["build-system"]["requires"]:
    print(re.sub("==.*", "", one).replace("-jazzy-", f"-{sys.argv[1]}-"))' "$distribution")
grep -v '^ros-' constraints.txt >"$place/constraints.txt"
PIP_CONSTRAINT=$place/constraints.txt PIP_BUILD_CONSTRAINT=$place/constraints.txt $pip install --use-pep517 setuptools $requires .
PATH=$place/bin:$PATH $pip install --no-deps --no-build-isolation ./msg_defs
"$place/bin/sal-height" run --preset small --dwells 2 --out "$place/run"
