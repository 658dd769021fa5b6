//! The facts of one episode in flat, reusable buffers, filled in the order of its steps.
//! Never allocates once warm.

use crate::facts::{Authority, Change, MarkerReferent, ObjectKey, StepHead};

/// One episode as facts. Filled from the start on: what the start saw and how its graphs
/// differ from the task's, then [`EpisodeFacts::step`] once a step, each followed by what came
/// with it. See [`crate::TaskFacts::begin`].
#[derive(Clone, PartialEq, Debug)]
pub struct EpisodeFacts {
    /// The first is the start.
    rows: Vec<StepOffsets>,
    physics: Vec<Change>,
    registry: Vec<Change>,
    seen: Vec<ObjectKey>,
    markers: Vec<(u32, MarkerReferent)>,
}

/// A moment, and where what came with it ends in the buffers.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct StepOffsets {
    head: StepHead,
    physics: usize,
    registry: usize,
    seen: usize,
    markers: usize,
    /// Whether the call set the marker map.
    marked: bool,
}

/// The state before the first decision.
#[derive(Clone, Copy, Debug)]
pub struct StartFacts<'a> {
    /// From the task's initial graph to the physical one.
    pub physics: &'a [Change],
    /// From the task's initial graph to the registry.
    pub registry: &'a [Change],
    /// Objects in the first image.
    pub visible: &'a [ObjectKey],
}

/// Facts of one step: the call, the graph changes and what was seen.
#[derive(Clone, Copy, Debug)]
pub struct StepFacts<'a> {
    /// Its columns of one value.
    pub head: StepHead,
    /// Changes of the physical graph.
    pub physics: &'a [Change],
    /// Changes of the registry.
    pub registry: &'a [Change],
    /// Objects in the image or told in words. Those seen before may be left out.
    pub visible: &'a [ObjectKey],
    /// The marker map after the call; none: as it was before.
    pub markers: Option<&'a [(u32, MarkerReferent)]>,
}

impl Default for EpisodeFacts {
    fn default() -> Self {
        let (rows, physics, registry, seen, markers) =
            (vec![StepOffsets::default()], vec![], vec![], vec![], vec![]);
        Self {
            rows,
            physics,
            registry,
            seen,
            markers,
        }
    }
}

impl EpisodeFacts {
    /// Starts another episode in the same buffers.
    pub(crate) fn clear(&mut self) {
        self.rows.truncate(1);
        self.rows[0] = StepOffsets::default();
        self.physics.clear();
        self.registry.clear();
        self.seen.clear();
        self.markers.clear();
    }

    /// Opens the next step: what is told from now on belongs to it.
    pub fn step(&mut self, head: StepHead) {
        self.rows.push(StepOffsets {
            head,
            marked: false,
            ..self.open()
        });
    }

    /// A change of one of the graphs, in the order of the record; before the first step: from
    /// the task's initial graph.
    pub fn change(&mut self, authority: Authority, change: Change) {
        match authority {
            Authority::Physics => self.physics.push(change),
            Authority::Registry => self.registry.push(change),
        }
        self.close();
    }

    /// An object in the image, or told in words. It is enough to tell when it is seen
    /// for the first time.
    pub fn push_visible(&mut self, object: ObjectKey) {
        self.seen.push(object);
        self.close();
    }

    /// The marker map after the call: [`EpisodeFacts::mark`] follows for each number, in ascending
    /// order, or for none. A step without this leaves the map as it was.
    pub fn set_markers(&mut self) {
        self.rows
            .last_mut()
            .expect("the start is always there")
            .marked = true;
    }

    /// A number of the marker map that [`EpisodeFacts::set_markers`] announced.
    pub fn mark(&mut self, number: u32, target: MarkerReferent) {
        self.markers.push((number, target));
        self.close();
    }

    /// How many steps there are.
    pub fn len(&self) -> usize {
        self.rows.len() - 1
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The state before the first decision.
    pub fn start(&self) -> StartFacts<'_> {
        let end = &self.rows[0];
        StartFacts {
            physics: &self.physics[..end.physics],
            registry: &self.registry[..end.registry],
            visible: &self.seen[..end.seen],
        }
    }

    /// The steps in their order.
    pub fn steps(&self) -> impl ExactSizeIterator<Item = StepFacts<'_>> {
        self.rows.windows(2).map(|rows| {
            let [before, row] = rows else {
                unreachable!("a window of two")
            };
            StepFacts {
                head: row.head,
                physics: &self.physics[before.physics..row.physics],
                registry: &self.registry[before.registry..row.registry],
                visible: &self.seen[before.seen..row.seen],
                markers: row
                    .marked
                    .then(|| &self.markers[before.markers..row.markers]),
            }
        })
    }

    fn open(&self) -> StepOffsets {
        *self.rows.last().expect("the start is always there")
    }

    fn close(&mut self) {
        let (physics, registry) = (self.physics.len(), self.registry.len());
        let (seen, markers) = (self.seen.len(), self.markers.len());
        let row = self.rows.last_mut().expect("the start is always there");
        *row = StepOffsets {
            physics,
            registry,
            seen,
            markers,
            ..*row
        };
    }
}
