// The solver's state machine on the device: solver::Control is the same struct on the host.
struct Control {
    running: u32,           // 1 during a refinement step
    status: u32,            // STATUS_*
    iterations: u32,        // in all refinement steps
    max_iterations: u32,
    first: u32,             // 1 until the first iteration of the step is over
    refinements: u32,       // refinement steps begun
    unknowns: u32,          // active cells, or free components of nodes
    n_lists: u32,           // lists whose dispatch sizes open during a refinement step
}

const STATUS_RUNNING = 0u;
const STATUS_CONVERGED = 1u;
const STATUS_MAX_ITERATIONS = 2u;
const STATUS_BREAKDOWN = 3u;
const STATUS_STAGNATED = 4u;
