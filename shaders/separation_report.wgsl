// solve with separation, after separation_openings: writes the sum to separation_sums (see separation). One workgroup.
// partials: rates, m/s. separation_sums: out.
#import fold
#import real
#import separation

// As fields::pressure_system has it.
const FOLD_THREADS = 4096u;

@group(0) @binding(0) var<storage, read> partials: array<Real4>;
@group(0) @binding(1) var<storage, read_write> separation_sums: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn separation_report(@builtin(local_invocation_index) lane: u32) {
    let sum = fold(FOLD_THREADS, lane).x;
    if lane == 0u {
        let high = f32(sum);
        separation_sums[OPENING] = bitcast<u32>(high);
        separation_sums[OPENING + 1u] = bitcast<u32>(f32(sum - Real(high)));
    }
}
