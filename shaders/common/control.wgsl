#import control_state

// Dispatch sizes that follow the state, four words each: the lists (those of all levels) while a round runs, then the
// extra ones.
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

// The update of x and r, which outlives the round by one kernel; the turn from one round to the next; the start of a round.
const UPDATE = 0u;
const TURN = 1u;
const BEGIN = 2u;
