"""Parts of schemes for constraints: their discrete Jacobians, masses and velocities, impulses at bare nodes."""
