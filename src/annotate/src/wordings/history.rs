//! What was done and learned, one sentence a deed, in the first person and the past tense.

crate::voice::wordings! {
    "history.txt":
    NOTHING_YET WENT WENT_BACK LOOKED ALSO_SAW LOOKED_IN_VAIN WALKED WALKED_IN_VAIN MARKED_PLACES
    GAZED PICKED PLACED OPENED CLOSED ASKED ASKED_IN_VAIN LISTED CALLED FAILED
}
