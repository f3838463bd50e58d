# Sourced by the set-up scripts: what they need of a Debian machine, from its own configuration of apt.

# Debian's own keys.
KEYRING=/usr/share/keyrings/debian-archive-keyring.gpg

# Ends a script with what to do.
fail() {
  echo "$*" >&2
  exit 1
}

# One at a time: two set-ups may run side by side.
apt_get() {
  mkdir -p target
  DEBIAN_FRONTEND=noninteractive flock target/apt.lock apt-get "$@"
}

# The first address of a Debian archive in apt's source files, whichever of their two forms they have.
mirror() {
  awk '/^[[:space:]]*#/ { next }
    { for (i = 1; i <= NF; i++) if ($i ~ /^https?:\/\/.*\/debian\/?$/) { print $i; exit } }' "$@"
}

# The mirror that this machine's apt uses.
configured_mirror() {
  local files=() file
  for file in /etc/apt/sources.list.d/* /etc/apt/sources.list; do
    [ ! -f "$file" ] || files+=("$file")
  done
  [ ${#files[@]} -eq 0 ] || mirror "${files[@]}"
}

# From the list of `apt-cache madison`, the version of the package that holds a release.
version_of_release() {
  awk -v start="$1+" 'index($3, start) == 1 { print $3; exit }'
}

# From the list of `apt-cache madison`, the suite of the first version whose major number is high enough.
suite_from_version() {
  awk -v least="$1" '{ version = $3; sub(/^[0-9]+:/, "", version) }
    version + 0 >= least { sub(/\/.*/, "", $6); print $6; exit }'
}
