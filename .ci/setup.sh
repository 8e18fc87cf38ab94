# Set-up that .ci/demo, .ci/test and .ci/run share: to be sourced. Nothing is downloaded that is already there.
# shellcheck shell=bash

set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# A fresh installation of Rust reaches PATH only at the next login.
PATH=$PATH:${CARGO_HOME:-$HOME/.cargo}/bin

# Mesa's window-system code complains where there is none, as in a container.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$PWD/target}

say() { printf '\n== %s\n' "$*"; }

# timed COMMAND...: prints how long it took.
timed() {
    say "$*"
    local start=$SECONDS
    "$@"
    printf '   %s s\n' "$((SECONDS - start))"
}

fail() {
    printf 'error: %s\n' "$*" >&2
    exit 1
}

# apt_install PACKAGE...: Debian packages, as root or through sudo.
apt_install() {
    command -v apt-get >/dev/null || fail "this system has no apt-get; install what gives Debian's $* and run this again"
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || fail "as root: apt-get install $*"
        as_root=(sudo)
    fi
    say "installing $*"
    if [ -z "${lists_are_fresh:-}" ]; then
        "${as_root[@]}" apt-get update -q </dev/null
        lists_are_fresh=yes
    fi
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -q -y --no-install-recommends -o DPkg::Lock::Timeout=300 "$@" </dev/null
}

# Rust, and the linker that it needs.
need_rust() {
    command -v cargo >/dev/null || fail "cargo not found: install Rust (https://rustup.rs) and run this again"
    command -v cc >/dev/null || apt_install gcc libc6-dev
}

# first FILE...: the first that exists; the names may come from a glob that matched nothing.
first() {
    local file
    for file in "$@"; do
        if [ -e "$file" ]; then
            printf '%s\n' "$file"
            return
        fi
    done
    return 1
}

# The Vulkan driver of Mesa for CPUs. The loader is there with it: the package needs it.
lavapipe_icd() {
    first /usr/share/vulkan/icd.d/lvp_icd."$(uname -m)".json /usr/share/vulkan/icd.d/lvp_icd*.json
}

# SwiftShader, as Debian's chromium has it. Nothing chooses it by itself: it lies outside the loader's folders.
swiftshader_icd() {
    first /usr/lib/chromium/vk_swiftshader_icd.json
}

need_vulkan_loader() {
    [[ $(/sbin/ldconfig -p) == *libvulkan.so.1* ]] || apt_install libvulkan1
}

need_lavapipe() {
    need_vulkan_loader
    lavapipe_icd >/dev/null || apt_install mesa-vulkan-drivers
    lavapipe_icd >/dev/null || fail "mesa-vulkan-drivers has no lvp_icd*.json in /usr/share/vulkan/icd.d"
}

# The layer that checks every call of Vulkan.
need_validation_layer() {
    first /usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json >/dev/null || apt_install vulkan-validationlayers
}

need_swiftshader() {
    need_vulkan_loader
    swiftshader_icd >/dev/null || apt_install chromium-common
    swiftshader_icd >/dev/null || fail "chromium-common has no /usr/lib/chromium/vk_swiftshader_icd.json"
}

# A browser without a screen, for the pages that the program writes.
need_browser() {
    command -v "${CUTWATER_BROWSER:-chromium-headless-shell}" >/dev/null || apt_install chromium-headless-shell
}

# Python, for the tables of docs/measured.
need_python() {
    command -v python3 >/dev/null || apt_install python3
}

# virtual_environment FOLDER REQUIREMENTS: installs packages with pip, unless they are there.
virtual_environment() {
    if cmp -s "$2" "$1/requirements.txt" && "$1/bin/python" --version >/dev/null 2>&1; then
        return
    fi
    python3 -c 'import ensurepip, venv' 2>/dev/null || apt_install python3 python3-venv
    say "installing $2 into $1"
    python3 -m venv --clear "$1"
    "$1/bin/python" -m pip install --quiet --disable-pip-version-check -r "$2"
    cp "$2" "$1/requirements.txt"
}

# The independent readers of the output files; sets CUTWATER_PYTHON.
need_readers() {
    virtual_environment "$PWD/target/readers" tests/readers/requirements.txt
    export CUTWATER_PYTHON=$PWD/target/readers/bin/python
}

# Python with what the tests of the package need; sets python.
need_package_python() {
    virtual_environment "$PWD/target/python" python/tests/requirements.txt
    python=$PWD/target/python/bin/python
    export PATH=$PWD/target/python/bin:$PATH
}

# The type stubs of the extension, target/stubs/cutwater/_core.pyi.
need_stubs() {
    need_package_python
    timed "$python" -m maturin generate-stubs --profile release --interpreter "$python" --out target/stubs
}

# Builds the wheel of the Python package into target/wheels; sets python and wheel.
need_wheel() {
    need_package_python
    rm -rf target/wheels
    timed "$python" -m maturin build --release --strip --interpreter "$python" --out target/wheels
    wheel=$(first target/wheels/cutwater-*.whl) || fail "maturin wrote no wheel into target/wheels"
}
