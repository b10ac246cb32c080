"""A simulator of the user's own as the nominal model: how it is declared, and its rollout in numpy.

simulator   the user's step function, and where one is kept at hand
onnx_step   such a function given as an ONNX model
dynamics    the nominal model that it makes
timeline    the command that reaches the joint in each step
step        one step, with the effects that act at the joint
run         an episode laid out for its rollout
rollout     episodes in windows, side by side
filter      the filter that runs ahead of them
sensors     what is observed of a rollout
"""
