# The table of the determinism checks: sourced by determinism.sh and determinism-cross.sh, not run.
#
# A column is one condition: what a build printed under it, a line `name digest` for each episode and each scene (the
# first column and the replays have no scenes). Every digest has to equal the one the trace recorded (a scene: the one of
# the first column that has it), but for the negative controls, each of which has to differ somewhere.
# shellcheck shell=bash

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
titles=()  # of the columns
notes=()   # the reason why a column is skipped, or empty
control=() # 1 for a negative control
failed=0

# read_traces REEL DIGESTS DIR: the traces as JSON lines, the names of the rows, and the first column.
read_traces() {
  local reel=$1 digests=$2 dir=$3 trace
  # not in its folders: they hold traces of older simulators
  if ! find "$dir" -maxdepth 1 -name '*.mcap' 2>/dev/null | LC_ALL=C sort >"$work/traces" || [[ ! -s $work/traces ]]; then
    echo "no traces in $dir: set REEL_TRACES to a folder of them" >&2
    exit 2
  fi
  while read -r trace; do "$reel" show "$trace" --json; done <"$work/traces" >"$work/episodes"
  "$digests" --recorded <"$work/episodes" >"$work/recorded"
  # id and the file's name, in one row
  paste -d ' ' <(cut -d ' ' -f 1 "$work/recorded") <(sed 's|.*/||; s|\.mcap$||' "$work/traces") >"$work/names"
  column "recorded in the trace" cat "$work/recorded"
}

# column TITLE COMMAND...: one condition; the command reads the episodes and prints digests.
column() {
  local title=$1 begin=$SECONDS
  shift
  titles+=("$title") notes+=("") control+=(0)
  if ! "$@" <"$work/episodes" >"$work/column.${#titles[@]}"; then
    notes[-1]="failed"
    failed=1
  fi
  echo "== $title: $((SECONDS - begin)) s" >&2
}

# negative_control TITLE COMMAND...: a column that has to differ.
negative_control() {
  column "$@"
  control[-1]=1
}

# skip TITLE REASON: a condition that this machine cannot make.
skip() {
  titles+=("$1") notes+=("skipped: $2") control+=(0)
  : >"$work/column.${#titles[@]}"
  echo "== $1: skipped: $2" >&2
}

# print_table: the conditions, one row for each episode and scene, and the verdict, which is the exit code.
print_table() {
  local at
  for at in "${!titles[@]}"; do
    printf '%s\t%s\t%s\t%s\n' "$((at + 1))" "${control[at]}" "${titles[at]}" "${notes[at]}"
  done >"$work/conditions"
  awk -v work="$work" -v failed="$failed" '
    BEGIN {
      while ((getline line < (work "/conditions")) > 0) {
        split(line, field, "\t"); columns = field[1]; control[columns] = field[2]; controls += field[2]; note[columns] = field[4]
        printf "%2d  %s%s\n", columns, field[3], (field[4] == "" ? "" : " (" field[4] ")")
      }
      while ((getline line < (work "/names")) > 0) { split(line, field, " "); name[field[1]] = field[2] }
      for (c = 1; c <= columns; c++) {
        while ((getline line < (work "/column." c)) > 0) {
          split(line, field, " "); row = field[1]
          if (!(row in reference)) { rows++; order[rows] = row; reference[row] = field[2] }
          digest[row, c] = field[2]; if (!(row in name)) scenes[c] = 1
        }
      }
      printf "\n%-52s %-16s", "episode or scene", "digest"
      for (c = 1; c <= columns; c++) printf " %2d", c
      print ""
      for (r = 1; r <= rows; r++) {
        row = order[r]; label = row in name ? name[row] : row
        printf "%-52s %-16s", label, substr(reference[row], 1, 16)
        for (c = 1; c <= columns; c++) {
          if (!((row, c) in digest)) { cell = "-"; if (note[c] == "" && (row in name || scenes[c])) lacks[c] = 1 }
          else if (digest[row, c] == reference[row]) cell = "="
          else { cell = "x"; differs[c]++; if (!control[c]) detail = detail sprintf("%s, condition %d: %s\n", label, c, digest[row, c]) }
          printf " %2s", cell
        }
        print ""
      }
      printf "\n%s", detail
      for (c = 1; c <= columns; c++) {
        if (control[c] && note[c] == "" && !differs[c]) { print "negative control " c " was not seen: the check is blind"; failed = 1 }
        if (!control[c] && differs[c]) { print "condition " c " gives other digests"; failed = 1 }
        if (lacks[c]) { print "condition " c " lacks a digest"; failed = 1 }
      }
      if (!failed) print "every digest is equal" (controls ? "; every negative control was seen" : "")
      exit failed
    }
  '
}
