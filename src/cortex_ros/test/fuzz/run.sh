#!/usr/bin/env bash
# Fuzzes the packet decoder: run.sh [RUNS | SECONDSs] [BUILD_DIR]
#   RUNS       number of inputs (default 1000000), e.g. 5000000
#   SECONDSs   or a time, e.g. 600s
#   BUILD_DIR  for the programs, the growing corpus and crashing inputs; kept. Default: a temporary one,
#              removed when nothing was found
# Exit code: 0 nothing found; 2 wrong use or no compiler; other: a finding, its input is in BUILD_DIR/findings.
set -euo pipefail

fail() { echo "fuzz/run.sh: $1" >&2; exit 2; }

amount=${1:-1000000}
case $amount in
  *[!0-9]*s | s) fail "'$amount' is neither a number of runs nor a time like 600s" ;;
  *s) limit=-max_total_time=${amount%s} ;;
  '' | *[!0-9]*) fail "'$amount' is neither a number of runs nor a time like 600s" ;;
  *) limit=-runs=$amount ;;
esac
compiler=$(command -v clang++ || command -v clang++-14) ||
  fail "clang++ is missing: apt-get install clang libclang-rt-14-dev"

package=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
if [ $# -ge 2 ]; then
  mkdir -p "$2"
  build=$(cd "$2" && pwd)
else
  build=$(mktemp -d)
  trap 'if [ $? -eq 0 ]; then rm -rf "$build"; else echo "kept: $build" >&2; fi' EXIT
fi
mkdir -p "$build"/{seeds,corpus,findings}

flags=(-std=c++17 -g1 -fno-omit-frame-pointer -Wall -Wextra -I "$package/include" -I "$package/test")
sanitizers=address,undefined,float-cast-overflow
"$compiler" "${flags[@]}" "$package"/test/fuzz/make_corpus.cpp "$package"/{src/protocol,test/encode}.cpp -o "$build/make_corpus"
"$compiler" "${flags[@]}" -O1 -fsanitize=fuzzer,$sanitizers -fno-sanitize-recover=all \
  "$package"/test/fuzz/fuzz_protocol.cpp "$package"/{src/protocol,test/encode}.cpp -o "$build/fuzz_protocol"

"$build/make_corpus" "$build/seeds"
cp "$package"/test/golden/*.bin "$build/seeds/"

# A fixed seed: the same inputs every time for the same corpus.
"$build/fuzz_protocol" -seed=1 -max_len=2048 -timeout=10 -print_final_stats=1 -print_funcs=0 -print_pcs=0 "$limit" \
  -artifact_prefix="$build/findings/" "$build/corpus" "$build/seeds"
