// Sites of the markers that a source emits with a level: Lattice in geometry/sources_sinks.rs, emission in reference/exchange.rs.
// The importing kernel declares source_step: SourceStep, regions: array<Region>, map: array<u32>, cells: array<vec4<u32>> and
// lattices: array<Lattice>.
#import hash
#import region
#import source_step

struct Lattice {
    // Displacement at the end of the sub-step, whole eighths of cells along each axis, and the rest, units; that in the sub-step.
    whole: vec4<i32>,
    rest: vec4<i32>,
    moved: vec4<i32>,
}

// Units of the edge of an eighth, and the number of their bits.
const UNITS = 65536;
const UNIT_BITS = 16u;
// Candidates for sites in a cell: corners of its eighths.
const CANDIDATES = 64u;

struct Site {
    // Eighths, twice the resolution of cells.
    eighth: vec3<i32>,
    // From its low corner, units.
    within: vec3<i32>,
    emitted: bool,
}

fn bits_of(number: u32) -> vec3<i32> {
    return vec3<i32>(vec3<u32>(number, number >> 1u, number >> 2u) & vec3<u32>(1u));
}

// Whether the source fills an eighth.
fn fills(source: u32, eighth: vec3<i32>) -> bool {
    let part = vec3<u32>(eighth & vec3<i32>(1));
    let bit = part.x | part.y << 1u | part.z << 2u;
    for (var r = 0u; r < arrayLength(&regions); r++) {
        if regions[r].number == source {
            let word = word_of(regions[r], vec3<u32>(eighth >> vec3<u32>(1u)));
            if word == NOWHERE || map[word] == 0u {
                return false;
            }
            return (eighths_of(cells[map[word] - 1u].w) >> bit & 1u) == 1u;
        }
    }
    return false;
}

// Candidate `number` in a source cell.
fn candidate(cell: vec4<u32>, number: u32) -> Site {
    let source = source_of(cell.w);
    let lattice = lattices[source];
    var site: Site;
    site.eighth = 2 * vec3<i32>(cell.xyz) + bits_of(number >> 3u);
    let below = bits_of(number & 7u);
    let of_lattice = bitcast<vec3<u32>>(site.eighth - lattice.whole.xyz - below);
    var bits = scatter(source_step.seed);
    bits = scatter(bits ^ of_lattice.x);
    bits = scatter(bits ^ of_lattice.y);
    bits = scatter(bits ^ of_lattice.z);
    for (var axis = 0u; axis < 3u; axis++) {
        bits = scatter(bits);
        site.within[axis] = lattice.rest[axis] - UNITS * below[axis] + i32(bits >> 16u);
    }
    let filled = (eighths_of(cell.w) >> (number >> 3u) & 1u) == 1u;
    let inside = all(site.within >= vec3<i32>()) && all(site.within < vec3<i32>(UNITS));
    if filled && inside {
        let origin = site.eighth + ((site.within - lattice.moved.xyz) >> vec3<u32>(UNIT_BITS));
        site.emitted = runs(source, source_step.starting) || !fills(source, origin);
    }
    return site;
}
