// exchange with sources, last of three: appends the new markers, each at a jittered position in an eighth of its cell
// (hash in the twin, reference/exchange.rs). Unused slots are cleared.
// One thread per slot, 8 per source cell.
// level, step. source_step: state of the sources. cells: x, y, z and word (see source_step) of each. starts: new
// markers in earlier cells. report: their number. markers: x, y, z (m), w = 1 alive, 0 deleted.
#import dispatch
#import hash
#import layout
#import step
#import report
#import source_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> source_step: SourceStep;
@group(0) @binding(3) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;
@group(0) @binding(5) var<storage, read> report: array<u32>;
@group(0) @binding(6) var<storage, read_write> markers: array<vec4<f32>>;

// Margin without jitter on each side, as a fraction of an eighth's edge.
const MARGIN = 0.02;

// The eighth with an index among those of the set.
fn nth(eighths: u32, number: u32) -> u32 {
    var rest = eighths;
    for (var n = 0u; n < number; n++) {
        rest &= rest - 1u;
    }
    return firstTrailingBit(rest);
}

// Position of marker `number` in a cell with `count` markers in its eighths, cells.
fn place(cell: vec3<u32>, eighths: u32, count: u32, number: u32) -> vec3<f32> {
    let index = cell.x + level.cells.x * (cell.y + level.cells.y * cell.z);
    let of_cell = scatter(scatter(scatter(source_step.seed) ^ source_step.number) ^ index);
    let eighth = nth(eighths, (number + of_cell) % countOneBits(eighths));
    var bits = scatter(of_cell ^ (number - count + 1u));
    var within: vec3<f32>;
    for (var axis = 0u; axis < 3u; axis++) {
        bits = scatter(bits);
        // The upper 24 bits, scaled to [0, 1).
        let jitter = f32(bits >> 8u) / 16777216.0;
        within[axis] = 0.5 * (f32(eighth >> axis & 1u) + MARGIN + (1.0 - 2.0 * MARGIN) * jitter);
    }
    return vec3<f32>(cell) + within;
}

@compute @workgroup_size(WG_SIZE)
fn seed_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    let n = arrayLength(&cells);
    if index >= PER_CELL * n {
        return;
    }
    let cell = index / PER_CELL;
    let turn = index % PER_CELL;
    let total = report[EMITTED_NOW];
    let first = starts[cell];
    var end = total;
    if cell + 1u < n {
        end = starts[cell + 1u];
    }
    let lacks = end - first;
    if turn < lacks {
        let eighths = eighths_of(cells[cell].w);
        let count = countOneBits(eighths) - lacks;
        let at = place(cells[cell].xyz, eighths, count, count + turn);
        markers[source_step.first + first + turn] = vec4<f32>(at * step.dx, 1.0);
    } else {
        // Threads without a marker clear the slots behind the new ones, in order: `end` of the threads before this
        // one have a marker.
        markers[source_step.first + total + index - end] = vec4<f32>();
    }
}
