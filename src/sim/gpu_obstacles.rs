//! Moving obstacles in the liquid of a scene without solids: the host moves and clips them, the device receives the
//! cut quads. With solids [`GpuCoupling`](super::gpu_coupling::GpuCoupling) does both.

use crate::Error;
use crate::fields::{ClipBuffers, ClipSize, CutQuads};
use crate::geometry::SolidClip;
use crate::gpu::{Dispatches, Gpu};

use super::gpu_liquid::GpuLiquid;

/// The obstacles on the device.
#[derive(Debug)]
pub(super) struct GpuObstacles {
    /// Clipping of the present obstacles.
    pub(super) clip: SolidClip,
    on_device: ClipBuffers,
    pub(super) stage: Dispatches,
}

impl GpuObstacles {
    /// Allocates and compiles, including the liquid stages that depend on the clipping. The state must be written
    /// afterwards.
    pub(super) fn new(gpu: &Gpu, clip: SolidClip, liquid: &mut GpuLiquid) -> Result<GpuObstacles, Error> {
        let grid = liquid.buffers.plan.grid;
        let size = ClipSize::of(&grid, &clip, 0).ample();
        let on_device = ClipBuffers::new(gpu, &grid, size)?;
        let stage = bind(gpu, liquid, &on_device)?;
        Ok(GpuObstacles { clip, on_device, stage })
    }

    /// Writes the clipping of a state at a time, s.
    pub(super) fn write(&mut self, gpu: &Gpu, liquid: &mut GpuLiquid, time: f64) -> Result<(), Error> {
        let cut = self.move_to(gpu, liquid, time, 0.0)?;
        liquid.buffers.write_cut_cells(gpu, self.clip.cut_cells());
        self.on_device.write(gpu, (&self.clip, cut), &[], true);
        Ok(())
    }

    /// Moves the obstacles to a time, with their velocities over the following dt (both s), and writes the clipping
    /// before all work submitted later.
    ///
    /// # Errors
    /// [`Error::Limit`] when a larger capacity exceeds the adapter's limits.
    pub(super) fn update_clip(&mut self, gpu: &Gpu, liquid: &mut GpuLiquid, time: f64, dt: f64) -> Result<(), Error> {
        let cut = self.move_to(gpu, liquid, time, dt)?;
        self.on_device.write(gpu, (&self.clip, cut), &[], false);
        Ok(())
    }

    fn move_to(&mut self, gpu: &Gpu, liquid: &mut GpuLiquid, time: f64, dt: f64) -> Result<CutQuads, Error> {
        self.clip.move_obstacles(time, dt);
        let cut = self.on_device.cut(&self.clip);
        if !self.on_device.fits(&cut) {
            let grid = &liquid.buffers.plan.grid;
            let needed = ClipSize::of(grid, &self.clip, self.on_device.n_differing()).ample();
            let size = self.on_device.size.joined(needed);
            self.on_device = self.on_device.resized(gpu, size)?;
            self.stage = bind(gpu, liquid, &self.on_device)?;
        }
        Ok(cut)
    }
}

/// Binds the liquid stages that depend on the clipping, and returns the stage `clip`.
fn bind(gpu: &Gpu, liquid: &mut GpuLiquid, clip: &ClipBuffers) -> Result<Dispatches, Error> {
    let GpuLiquid { buffers, solver, stages, .. } = liquid;
    stages.beside_bodies = vec![
        crate::stages::extrapolate(gpu, buffers, Some((clip, None)))?,
        crate::stages::diagnose(gpu, (buffers, liquid.level.as_ref()), solver, None)?,
    ];
    crate::stages::clip(gpu, buffers, clip)
}
