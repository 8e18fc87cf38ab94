// Part of the volume control that acts on a component: reference/level_exchange.rs. The importing kernel declares level_step:
// LevelStep.
#import level_step

// Of a component with a volume, in volumes of a cell.
fn controlled_part(volume: f32) -> f32 {
    if level_step.renewed > 0.0 {
        return clamp(volume / level_step.renewed - 1.0, 0.0, 1.0);
    }
    return 1.0;
}
