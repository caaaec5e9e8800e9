# Answer the free decays of one mass and leave all other rows empty; run in the folder of the round. Not tested.
# Packages: CSV, DataFrames, JSON, LsqFit.
using CSV, DataFrames, JSON, LinearAlgebra, LsqFit

function misfit(p, t, x)                    # x = exp(-c/2m t) (A cos wt + B sin wt)
    w = sqrt(max(exp(p[1]) - exp(2p[2]) / 4, 1e-12))
    B = exp.(-exp(p[2]) / 2 .* t) .* [cos.(w .* t) sin.(w .* t)]
    return B * (B \ x) - x
end

function solve(name)
    known = JSON.parsefile("problems/$name.json")
    (known["system"]["kind"] != "sdof" || known["force"] !== nothing) && return Dict()
    d = CSV.read("problems/$name.csv", DataFrame)
    t, x, prior = d[:, 1], d[:, 2], known["prior"]
    m, c, k = (prior[key]["nominal"] for key in ("m", "c", "k"))
    fits = [curve_fit((t, p) -> misfit(p, t, x), t, zero(t), [log(k / m) + s, log(c / m)])
            for s in range(-1.5, 1.5, length = 60)]
    fit = argmin(f -> sum(abs2, f.resid), fits)
    covariance = inv(fit.jacobian' * fit.jacobian) * sum(abs2, fit.resid) / (length(t) - 4)
    sd = sqrt.(diag(covariance))
    return Dict(q => exp.([v, v - 1.96s, v + 1.96s]) for (q, v, s) in zip(("k/m", "c/m"), fit.param, sd))
end

rows = CSV.read("predictions_template.csv", DataFrame)
answers = Dict(name => solve(name) for name in unique(rows.scenario))
open("predictions.csv", "w") do file
    println(file, "scenario,quantity,value,low,high,seconds")
    for row in eachrow(rows)
        numbers = get(answers[row.scenario], row.quantity, ["", "", ""])
        println(file, join([row.scenario, row.quantity, numbers..., ""], ","))
    end
end
