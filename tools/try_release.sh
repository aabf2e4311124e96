#!/bin/sh
# Installs the wheels of a release into a new environment, and tries what a user would do first.
# Usage: try_release.sh PYTHON WHEELS
set -eu
python=$1
wheels=$(cd "$2" && pwd)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
export PIP_CONSTRAINT=$PWD/constraints.txt
unset PYTHONPATH

"$python" -m venv "$place/venv"
pip="$place/venv/bin/pip --disable-pip-version-check --quiet"
cd "$place"

echo 'Trying the core without ROS'
$pip install "$(echo "$wheels"/sal_height-*.whl)"
venv/bin/sal-height budget small >/dev/null
venv/bin/python -c 'import sal_height; print("sal_height", sal_height.__version__)'

echo 'Trying the nodes'
$pip install "$(echo "$wheels"/sal_height-*.whl)[ros]" "$wheels"/sal_height_msgs-*.whl
venv/bin/sal-height run --preset small --dwells 2 --out run
venv/bin/sal-height replay run/bag --out again
