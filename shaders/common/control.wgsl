#import control_state

// Dispatch sizes that follow the state, four words each: the lists (those of all levels) during a refinement
// step, then the extra ones.
// gated: those; args: the sizes of the lists. The including file declares control, gated and args.
fn gate_lists(open: bool) {
    for (var word = 0u; word < 4u * control.n_lists; word++) {
        gated[word] = select(0u, args[word], open);
    }
}

fn gate_extra(extra: u32, open: bool) {
    for (var word = 0u; word < 4u; word++) {
        gated[4u * (control.n_lists + extra) + word] = select(0u, args[word], open);
    }
}

// The update of x and r, which outlives the refinement step by one kernel; residual evaluation; start of a step.
const UPDATE = 0u;
const EVALUATE = 1u;
const BEGIN = 2u;
