"""Choice of the next steps of a run: where the leading explanations differ most for the rig's time.

Other rooms take `explanations.weighed`, `second_order`, and `choice.Option`, `Pool`, `best_block` and `bistable`.
"""
