//! Floor polygons as disjoint rectangles: exact where all sides run along x or y, else squares
//! whose middle lies inside.

use reel_world::Rect;

/// Side of the squares that approximate oblique walls, in metres.
pub(crate) const CELL_M: f64 = 0.25;
/// Most corners of a polygon.
const CORNERS_MAX: usize = 400;
/// Most squares of an oblique polygon.
const CELLS_MAX: f64 = 40_000.0;
/// A side is along an axis if it strays less from it, in metres.
const STRAIGHT_M: f64 = 0.005;

/// A floor as rectangles.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Floor {
    pub(crate) rects: Vec<Rect>,
    pub(crate) is_approximate: bool,
}

/// The rectangles of a polygon, or what is wrong with it.
pub(crate) fn rectangles(points: &[[f64; 2]]) -> Result<Floor, String> {
    if points.len() < 3 {
        return Err(format!(
            "has {} corners; a room needs three or more",
            points.len()
        ));
    }
    if points.len() > CORNERS_MAX {
        return Err(format!(
            "has {} corners, and at most {CORNERS_MAX} are read",
            points.len()
        ));
    }
    let points: Vec<[f64; 2]> = points
        .iter()
        .map(|point| point.map(|value| (value * 1000.0).round() / 1000.0))
        .collect();
    let is_straight =
        sides(&points).all(|(a, b)| (0..2).any(|axis| (a[axis] - b[axis]).abs() < STRAIGHT_M));
    let lines = [0, 1].map(|axis| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        values.dedup_by(|next, kept| *next - *kept < STRAIGHT_M);
        values
    });
    let lines = if is_straight { lines } else { squares(&lines)? };
    let rects = joined_cells(&lines, &points);
    if rects.is_empty() {
        return Err("encloses no floor".to_owned());
    }
    Ok(Floor {
        rects,
        is_approximate: !is_straight,
    })
}

fn sides(points: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> {
    let next = points.iter().cycle().skip(1);
    points.iter().copied().zip(next.copied())
}

/// Lines of a grid over the range of some values.
fn squares(lines: &[Vec<f64>; 2]) -> Result<[Vec<f64>; 2], String> {
    let spans = lines
        .each_ref()
        .map(|values| (values[0], values[values.len() - 1]));
    let counts = spans.map(|(low, high)| ((high - low) / CELL_M).ceil().max(1.0));
    if counts[0] * counts[1] > CELLS_MAX {
        return Err("has oblique sides and is too large to be cut into squares".to_owned());
    }
    Ok([0, 1].map(|axis| {
        let (low, high) = spans[axis];
        let step = (high - low) / counts[axis];
        (0..=counts[axis] as usize)
            .map(|index| low + step * index as f64)
            .collect()
    }))
}

/// The cells of a grid inside of a polygon, joined along x, then along y.
fn joined_cells([xs, ys]: &[Vec<f64>; 2], points: &[[f64; 2]]) -> Vec<Rect> {
    let mut rects: Vec<Rect> = Vec::new();
    for y in ys.windows(2) {
        let mut row: Vec<Rect> = Vec::new();
        for x in xs.windows(2) {
            if !contains(points, [(x[0] + x[1]) * 0.5, (y[0] + y[1]) * 0.5]) {
                continue;
            }
            match row.last_mut() {
                Some(last) if last.max[0] == x[0] => last.max[0] = x[1],
                _ => row.push(Rect {
                    min: [x[0], y[0]],
                    max: [x[1], y[1]],
                }),
            }
        }
        for rect in row {
            let below = rects.iter_mut().find(|other| {
                other.max[1] == rect.min[1]
                    && other.min[0] == rect.min[0]
                    && other.max[0] == rect.max[0]
            });
            match below {
                Some(below) => below.max[1] = rect.max[1],
                None => rects.push(rect),
            }
        }
    }
    rects
}

/// Whether a point is inside, by how many sides a ray along x crosses.
fn contains(points: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let crossed = sides(points).filter(|(a, b)| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])
    });
    crossed.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfaces::area;

    #[test]
    fn an_l_is_two_rectangles() {
        let l = [
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 2.0],
            [2.0, 2.0],
            [2.0, 5.0],
            [0.0, 5.0],
        ];
        let floor = rectangles(&l).expect("it is a polygon");
        assert!(!floor.is_approximate);
        assert_eq!(floor.rects.len(), 2);
        assert!((floor.rects.iter().map(area).sum::<f64>() - 14.0).abs() < 1e-9);
        let other_way: Vec<[f64; 2]> = l.into_iter().rev().collect();
        assert_eq!(rectangles(&other_way).expect("the same"), floor);
    }

    #[test]
    fn an_oblique_room_is_squares_of_about_its_area() {
        let floor = rectangles(&[[0.0, 0.0], [6.0, 0.0], [0.0, 6.0]]).expect("it is a polygon");
        let area: f64 = floor.rects.iter().map(area).sum();
        assert!(floor.is_approximate && (area - 18.0).abs() < 1.0, "{area}");
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(rectangles(&[[0.0, 0.0], [1.0, 0.0]]).is_err());
        assert!(rectangles(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]).is_err());
        assert!(rectangles(&[[0.0, 0.0], [9e5, 1.0], [0.0, 9e5]]).is_err());
    }
}
