#!/bin/sh
# Unpacks Python's C headers into DIRECTORY, without root, if python3-dev is not installed.
# Usage: python_headers.sh PYTHON DIRECTORY
set -eu
python=$1
directory=$2

"$python" -c 'import pathlib, sys, sysconfig; sys.exit(not pathlib.Path(sysconfig.get_path("include"), "Python.h").exists())' && exit

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
package=libpython$version-dev
mkdir -p "$directory/lists/partial"
cd "$directory"
echo "Python.h is missing; fetching it from the package $package"
# A machine without apt's package lists gets them in a folder of ours.
if ! { apt-get download -q "$package" ||
    { apt-get update -q -o Dir::State::Lists="$directory/lists" &&
        apt-get download -q -o Dir::State::Lists="$directory/lists" "$package"; } } >log 2>&1; then
    echo "Python.h is missing and could not be fetched (see $directory/log); install it with: sudo apt install python$version-dev" >&2
    exit 1
fi
dpkg-deb --fsys-tarfile "$package"_*.deb | tar x ./usr/include
rm -rf lists log ./*.deb
