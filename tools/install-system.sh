#!/usr/bin/env bash
# Installs what the build needs beside Rust: OpenCV, libclang, pkg-config and a C++ compiler.
# Does nothing where all of it is there. Debian and Ubuntu; elsewhere it says what is missing.
set -euo pipefail

packages=(libopencv-dev clang libclang-dev pkg-config g++)

installed() {
    dpkg-query -W -f='${Status}' "$1" 2>/dev/null | grep -q '^install ok installed$'
}

if ! command -v apt-get >/dev/null; then
    if pkg-config --exists opencv4 2>/dev/null && command -v clang >/dev/null; then
        exit 0
    fi
    cat >&2 <<'EOF'
platelight needs OpenCV 4 (with calib3d, aruco and stitching), clang with libclang, pkg-config and a
C++ compiler. This script installs them on Debian and Ubuntu only: please install them with your
system's package manager, or build without board and tag detection:
    cargo build --release --no-default-features
EOF
    exit 1
fi

missing=()
for package in "${packages[@]}"; do
    installed "$package" || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
        echo "not root and no sudo: please run as root: apt-get install ${missing[*]}" >&2
        exit 1
    fi
    as_root=(sudo)
fi

echo "installing ${missing[*]} (about 180 MB to download, 1 GB on disk)" >&2
# apt unpacks package scripts under TMPDIR; a folder of its own cannot be swept away meanwhile.
scratch=$(mktemp -d /var/tmp/platelight-apt.XXXXXX)
trap 'rm -rf "$scratch"' EXIT
chmod 755 "$scratch"
run_apt() {
    "${as_root[@]}" env TMPDIR="$scratch" DEBIAN_FRONTEND=noninteractive "$@"
}
run_apt apt-get update -q
run_apt apt-get install -q -y --no-install-recommends "${missing[@]}" || {
    echo "the first attempt failed; finishing half-installed packages and trying once more" >&2
    run_apt dpkg --configure -a
    run_apt apt-get install -q -y --no-install-recommends "${missing[@]}"
}
