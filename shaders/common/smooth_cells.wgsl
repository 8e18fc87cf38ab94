// A pass of (1/4, 1/2, 1/4) along each axis over mirrored neighbours, as LevelCells::smooth of the twin: a loop over the 27 taps, since
// compilers that inline would nest three passes 27 times. The importing kernel declares tap(cell) -> vec2<f32>, the values to smooth, and what
// level_cells asks for.
#import level_cells

fn smooth_cells(cell: u32) -> vec2<f32> {
    var sum = vec2<f32>();
    for (var number = 0u; number < 27u; number++) {
        // 0: the cell itself, 1 and 2: its sides. The last pass is the first step.
        let steps = vec3<u32>(number % 3u, number / 3u % 3u, number / 9u);
        var at = cell;
        var weight = 0.125;
        for (var pass_number = 0u; pass_number < 3u; pass_number++) {
            let axis = 2u - pass_number;
            if steps[axis] > 0u {
                at = beside(at, axis, steps[axis] - 1u);
                weight *= 0.5;
            }
        }
        sum += weight * tap(at);
    }
    return sum;
}
