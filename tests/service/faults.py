"""What goes wrong around `reel serve`, and what must not come of it: killed processes, full disks, clients that are slow, hostile
or strangers, clocks that jump. `faults.py [--list] [--quick] [NAME...]`; the command is $REEL.

Every test has a server of its own, and fails also where that panics, dies or does not stop. What this machine cannot do is said
as `skipped: ...`."""

import faults_access
import faults_clocks
import faults_hostile
import faults_kills
import faults_owners
import faults_slow
import faults_tls
import faults_words
from harness import main

if __name__ == "__main__":
    parts = [faults_kills, faults_slow, faults_hostile, faults_access, faults_owners, faults_tls, faults_words, faults_clocks]
    main("fault_", {name: test for part in parts for name, test in vars(part).items()})
