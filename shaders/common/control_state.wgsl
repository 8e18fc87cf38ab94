// The solver's state machine on the device: solver::Control is the same struct on the host.
struct Control {
    running: u32,           // 1 while a round goes on
    status: u32,            // STATUS_*
    iterations: u32,        // in all rounds
    max_iterations: u32,
    first: u32,             // 1 until the round has made its first step
    rounds: u32,            // rounds begun
    unknowns: u32,          // active cells, or free components of nodes
    n_lists: u32,           // lists whose dispatch sizes open while a round runs
}

const STATUS_RUNNING = 0u;
const STATUS_CONVERGED = 1u;
const STATUS_MAX_ITERATIONS = 2u;
const STATUS_BREAKDOWN = 3u;
const STATUS_STAGNATED = 4u;
