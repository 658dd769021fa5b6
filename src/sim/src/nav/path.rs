//! Shortest paths over the free cells: A* between two cells, and the cost from one cell to all.
//!
//! Costs are whole numbers, so that equal arguments give equal paths on every machine. Diagonal
//! steps never cut a corner.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{CELL_M, grid::Grid};

/// Cost of a step to one of the four neighbours.
const STRAIGHT: u32 = 1000;
/// Cost of a diagonal step.
const DIAGONAL: u32 = 1414;
/// Cost of what cannot be reached.
pub(super) const UNREACHED: u32 = u32::MAX;

/// A cost in metres.
pub(super) fn metres(cost: u32) -> f32 {
    cost as f32 * (CELL_M / STRAIGHT as f32)
}

/// Cost and cells of the shortest path between two free cells, both included, by A*. Ties go to the
/// lower estimate of the rest, then to the lower cell.
pub(super) fn shortest(grid: &Grid, from: usize, to: usize) -> Option<(u32, Vec<usize>)> {
    if !grid.connected(from, to) {
        return None;
    }
    let [goal_column, goal_row] = grid.place(to);
    let estimate = |cell: usize| {
        let [column, row] = grid.place(cell);
        let (dx, dy) = (
            column.abs_diff(goal_column) as u32,
            row.abs_diff(goal_row) as u32,
        );
        STRAIGHT * dx.max(dy) + (DIAGONAL - STRAIGHT) * dx.min(dy)
    };
    let mut cost = vec![UNREACHED; grid.len()];
    let mut parent = vec![from; grid.len()];
    let mut open = BinaryHeap::from([Reverse((estimate(from), estimate(from), from))]);
    cost[from] = 0;
    while let Some(Reverse((total, rest, cell))) = open.pop() {
        if cell == to {
            break;
        }
        if total - rest > cost[cell] {
            continue; // reached more cheaply since
        }
        for (next, step) in steps(grid, cell) {
            let reached = cost[cell] + step;
            if reached < cost[next] {
                cost[next] = reached;
                parent[next] = cell;
                let rest = estimate(next);
                open.push(Reverse((reached + rest, rest, next)));
            }
        }
    }
    let mut cells = vec![to];
    let mut cell = to;
    while cell != from {
        cell = parent[cell];
        cells.push(cell);
    }
    cells.reverse();
    Some((cost[to], cells))
}

/// Cost of the shortest path from a free cell to every cell ([`UNREACHED`] where there is none).
///
/// Dijkstra with buckets as wide as the cheapest step: nothing in a bucket can improve its own
/// bucket, so its cells are final in any order.
pub(super) fn costs_from(grid: &Grid, from: usize) -> Vec<u32> {
    let mut cost = vec![UNREACHED; grid.len()];
    if !grid.is_free(from) {
        return cost;
    }
    cost[from] = 0;
    let mut buckets = [vec![from], Vec::new(), Vec::new()];
    let mut bucket = 0u32;
    while buckets.iter().any(|cells| !cells.is_empty()) {
        let mut cells = std::mem::take(&mut buckets[bucket as usize % 3]);
        for cell in cells.drain(..) {
            if cost[cell] / STRAIGHT != bucket {
                continue; // reached more cheaply since
            }
            for (next, step) in steps(grid, cell) {
                let reached = cost[cell] + step;
                if reached < cost[next] {
                    cost[next] = reached;
                    buckets[(reached / STRAIGHT) as usize % 3].push(next);
                }
            }
        }
        buckets[bucket as usize % 3] = cells; // keeps its memory
        bucket += 1;
    }
    cost
}

/// The free neighbours of a free cell with the cost of the step.
fn steps(grid: &Grid, cell: usize) -> impl Iterator<Item = (usize, u32)> {
    let width = grid.width;
    let free = |cell: usize| grid.is_free(cell);
    let (west, east, south, north) = (cell - 1, cell + 1, cell - width, cell + width);
    let open = [free(west), free(east), free(south), free(north)];
    let diagonal =
        |beside: bool, above: bool, next: usize| (beside && above && free(next), next, DIAGONAL);
    [
        (open[0], west, STRAIGHT),
        (open[1], east, STRAIGHT),
        (open[2], south, STRAIGHT),
        (open[3], north, STRAIGHT),
        diagonal(open[0], open[2], south - 1),
        diagonal(open[1], open[2], south + 1),
        diagonal(open[0], open[3], north - 1),
        diagonal(open[1], open[3], north + 1),
    ]
    .into_iter()
    .filter_map(|(open, next, cost)| open.then_some((next, cost)))
}
