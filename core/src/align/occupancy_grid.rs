//! The batch's occupancy grid (`toOGM` of fastGlobalAlign l. 4).

/// An image of a batch, redrawn for every heading.
#[derive(Default)]
pub struct OccupancyGrid {
    image: Vec<f32>,
    /// Pixels that are not 0: what must be wiped before the next drawing.
    touched: Vec<u32>,
}

impl OccupancyGrid {
    /// Draws points that fall on `pixels`, each moved by `offset`, on a square image. A pixel's value
    /// is that of its number of hits, the last one for more.
    pub fn draw(&mut self, side: usize, pixels: &[u32], offset: usize, values: &[f32]) {
        self.clear(side);
        for pixel in pixels {
            let index = *pixel as usize + offset;
            if self.image[index] == 0.0 {
                self.touched.push(index as u32);
            }
            self.image[index] += 1.0;
        }
        let last = values.len() - 1;
        for index in &self.touched {
            let value = &mut self.image[*index as usize];
            *value = values[(*value as usize).min(last)];
        }
    }

    /// The image, row-major.
    #[must_use]
    pub fn image(&self) -> &[f32] {
        &self.image
    }

    fn clear(&mut self, side: usize) {
        if self.image.len() == side * side {
            for index in self.touched.drain(..) {
                self.image[index as usize] = 0.0;
            }
        } else {
            self.touched.clear();
            self.image = vec![0.0; side * side];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_worth_its_hits_and_the_last_drawing_is_wiped() {
        let mut grid = OccupancyGrid::default();
        grid.draw(4, &[0, 1, 1, 1], 5, &[0.0, 0.5, 0.75]);
        let drawn = |grid: &OccupancyGrid, i: usize| grid.image()[i].to_bits();
        assert_eq!([drawn(&grid, 5), drawn(&grid, 6)], [0.5_f32.to_bits(), 0.75_f32.to_bits()]);
        grid.draw(4, &[3], 0, &[0.0, 1.0]);
        let sum: f32 = grid.image().iter().sum();
        assert_eq!(sum.to_bits(), 1.0_f32.to_bits());
    }
}
