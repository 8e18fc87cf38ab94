// First of two levels of a long sum: thread t of FOLD_THREADS sums partials t, t + FOLD_THREADS, ... in order.
// level: whose list length is the number of partials. args: list lengths. partials: in. folded: out, FOLD_THREADS
// long.
#import dispatch
#import level
#import real

// Also solver::FOLD_THREADS.
const FOLD_THREADS = 4096u;

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read_write> folded: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn fold_partials(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    let n = args[level.args + 3u];
    var sum = Real4();
    for (var ix = thread; ix < n; ix += FOLD_THREADS) {
        sum += partials[ix];
    }
    folded[thread] = sum;
}
