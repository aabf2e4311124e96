#!/bin/sh
# Fails with one sentence if something is missing that `make setup` cannot fetch by itself.
# Usage: check_prerequisites.sh [PYTHON]
python=${1:-python3}

if ! command -v "$python" >/dev/null; then
    echo "$python is missing; install it with: sudo apt install python3 python3-venv" >&2
    exit 1
fi
if ! "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))'; then
    echo "$python is $("$python" --version 2>&1), but sal_height needs 3.11, 3.12 or 3.13;" \
        "install one (on Debian 12 and Ubuntu 24.04: sudo apt install python3 python3-venv)" \
        "and name it: make setup PYTHON=/usr/bin/python3" >&2
    exit 1
fi

missing=
for tool in gcc g++ make; do
    command -v $tool >/dev/null || missing="$missing $tool"
done
"$python" -c 'import ensurepip, venv' 2>/dev/null || missing="$missing $(basename "$python")-venv"
if [ -n "$missing" ]; then
    echo "sal_height needs what is not installed here; install it with: sudo apt install$missing" >&2
    exit 1
fi
