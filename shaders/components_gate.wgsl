// Stage closed_components, one thread: how many components are closed, and the dispatch sizes of what they, and those that touch
// nothing, call for: nothing if there are none.
// args: sizes of the lists. state: see components. sizes: for a thread per active quad, and for one per RUN quads.
#import dispatch
#import components

@group(0) @binding(0) var<storage, read> args: array<u32>;
@group(0) @binding(1) var<storage, read_write> state: array<u32>;
@group(0) @binding(2) var<storage, read_write> sizes: array<vec4<u32>>;

@compute @workgroup_size(1)
fn components_gate() {
    let closed = state[COUNTER];
    let quads = args[3];
    state[N_CLOSED] = closed;
    let any = closed + state[SEALS] + state[LOOSE] > 0u;
    state[LOOSE] = 0u;
    state[COUNTER] = 0u;
    state[SEALS] = 0u;
    state[QUADS] = quads;
    state[LARGEST] = 0u;
    state[LARGEST + 1u] = 0u;
    let flagged = select(0u, quads, any);
    let summed = select(0u, quads, closed > 0u);
    sizes[0] = vec4<u32>(workgroups_for(flagged), flagged);
    sizes[1] = vec4<u32>(workgroups_for((summed + RUN - 1u) / RUN), summed);
}
