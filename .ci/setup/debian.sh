# Functions for the setup scripts on a Debian machine; they use its configuration of apt.

# Debian's own keys.
KEYRING=/usr/share/keyrings/debian-archive-keyring.gpg

# Prints a message and ends the script.
fail() {
  echo "$*" >&2
  exit 1
}

# Locked, since two setup scripts may run at the same time.
apt_get() {
  mkdir -p target
  DEBIAN_FRONTEND=noninteractive flock target/apt.lock apt-get "$@"
}

# The first address of a Debian archive in apt's source files, in either of their two formats.
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

# From the output of `apt-cache madison`: the version of the package that contains a release.
version_of_release() {
  awk -v start="$1+" 'index($3, start) == 1 { print $3; exit }'
}

# From the output of `apt-cache madison`: the suite of the first version whose major number is high enough.
suite_from_version() {
  awk -v least="$1" '{ version = $3; sub(/^[0-9]+:/, "", version) }
    version + 0 >= least { sub(/\/.*/, "", $6); print $6; exit }'
}
