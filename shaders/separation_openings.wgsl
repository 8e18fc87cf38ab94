// solve with separation, before separation_update: partial sums of the rates at which the separated cells open, over dx^2, m/s.
// FOLD_THREADS threads; each sums every n-th quad of the band.
// level. band_args, band_list: the band. flags: see active, without separated lanes. open: apertures for the pressure. potential, rhs: m/s.
// separated: see separation. partials: out.
#import dispatch
#import opening
#import separation

// As fields::pressure_system has it.
const FOLD_THREADS = 4096u;

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> potential: array<Real4>;
@group(0) @binding(6) var<storage, read> rhs: array<Real4>;
@group(0) @binding(7) var<storage, read> separated: array<u32>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn separation_openings(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let thread = linear_index(workgroup, lane);
    if thread >= FOLD_THREADS {
        return;
    }
    var sum = Real(0.0);
    for (var index = thread; index < band_args[3]; index += FOLD_THREADS) {
        let quad = band_list[index];
        var now = separated[quad] & 15u;
        while now != 0u {
            let l = firstTrailingBit(now);
            now &= now - 1u;
            sum += opening(quad_cell(level, quad) + vec3<i32>(i32(l), 0, 0), rhs[quad][l]);
        }
    }
    partials[thread] = Real4(sum, Real(0.0), Real(0.0), Real(0.0));
}
