#!/usr/bin/env bash
# Installs what the simulators need to render without a GPU: Mesa's Vulkan driver (24.3 or newer, for SAPIEN)
# and its EGL/OpenGL libraries (for MuJoCo). Does nothing where they are already there. On a machine where it
# cannot install (not root, not Debian/Ubuntu) it prints the command to type and succeeds: `robogauntlet check installation`
# says later which simulators are affected.
set -euo pipefail

PACKAGES=(mesa-vulkan-drivers libvulkan1 libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri libglvnd0 libgles2 libosmesa6 libx11-6)
NEEDED_MESA=24.3

mesa_version() { dpkg-query -W -f='${Version}' mesa-vulkan-drivers 2>/dev/null || true; }
new_enough() { [ -n "$1" ] && dpkg --compare-versions "$1" ge "$NEEDED_MESA"; }
all_there() {
    for package in "${PACKAGES[@]}"; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || return 1
    done
}

if command -v nvidia-smi >/dev/null 2>&1 && nvidia-smi -L 2>/dev/null | grep -q GPU; then
    echo "render drivers: NVIDIA GPU found, its own Vulkan and EGL drivers are used"
    exit 0
fi
if ! command -v dpkg-query >/dev/null 2>&1; then
    echo "render drivers: not Debian or Ubuntu. Install Mesa >= $NEEDED_MESA (Vulkan lavapipe and EGL) with your package manager."
    exit 0
fi
if new_enough "$(mesa_version)" && all_there; then
    echo "render drivers: Mesa $(mesa_version) is installed"
    exit 0
fi
. /etc/os-release
if [ "$(id -u)" != 0 ]; then
    echo "render drivers: type this once, then run make again:  sudo bash $0"
    exit 0
fi

apt-get update -qq
target=()
candidate=$(apt-cache policy mesa-vulkan-drivers | awk '/Candidate:/ {print $2}')
if ! new_enough "$candidate" && [ "${ID:-}" = debian ]; then
    # The release's backports suite carries a newer Mesa. Its address is that of the machine's own sources.
    suite="${VERSION_CODENAME}-backports"
    list=/etc/apt/sources.list.d/robogauntlet-backports
    if ! apt-cache policy | grep -q "n=$suite"; then
        for source in /etc/apt/sources.list.d/*.sources; do
            [ -e "$source" ] || continue
            awk -v RS= -v name="$VERSION_CODENAME" -v suite="$suite" '
                $0 ~ "Suites:[^\n]*(^|[ \t])" name "([ \t\n]|$)" {
                    sub(/Suites:[^\n]*/, "Suites: " suite); print; exit }' "$source" > "$list.sources"
            [ -s "$list.sources" ] && break
            rm -f "$list.sources"
        done
        if [ ! -e "$list.sources" ] && [ -e /etc/apt/sources.list ]; then
            awk -v name="$VERSION_CODENAME" -v suite="$suite" '
                $1 == "deb" { for (i = 2; i <= NF; i++) if ($i == name) { $i = suite; print; exit } }' \
                /etc/apt/sources.list > "$list.list"
        fi
        apt-get update -qq
    fi
    target=(-t "$suite")
fi
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${target[@]}" "${PACKAGES[@]}" >/dev/null
echo "render drivers: Mesa $(mesa_version) installed"
new_enough "$(mesa_version)" || echo "render drivers: SAPIEN needs Mesa >= $NEEDED_MESA; ManiSkill will be skipped on this machine"
