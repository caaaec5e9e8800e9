% Answer the free decays of one mass and leave all other rows empty; run in the folder of the round. Not tested.
T = readtable('predictions_template.csv', 'TextType', 'string', 'Delimiter', ',');
out = fopen('predictions.csv', 'w');
fprintf(out, 'scenario,quantity,value,low,high,seconds\n');
answers = containers.Map;
for i = 1:height(T)
    name = char(T.scenario(i));
    if ~isKey(answers, name), answers(name) = solve_one(name); end
    j = find(["k/m", "c/m"] == T.quantity(i));
    a = answers(name);
    if isempty(a) || isempty(j)
        fprintf(out, '%s,%s,,,,\n', name, T.quantity(i));
    else
        fprintf(out, '%s,%s,%.9g,%.9g,%.9g,\n', name, T.quantity(i), a(j, 1), a(j, 2), a(j, 3));
    end
end
fclose(out);

function a = solve_one(name)
    a = [];
    known = jsondecode(fileread(['problems/' name '.json']));
    if ~strcmp(known.system.kind, 'sdof') || ~isempty(known.force), return, end
    d = readmatrix(['problems/' name '.csv'], 'NumHeaderLines', 1);
    start = log([known.prior.k.nominal, known.prior.c.nominal] / known.prior.m.nominal);
    options = optimoptions('lsqnonlin', 'Display', 'off');
    best = inf;
    for shift = linspace(-1.5, 1.5, 60)   % x = exp(-c/2m t) (A cos wt + B sin wt)
        [p, cost, ~, ~, ~, ~, J] = lsqnonlin(@(p) misfit(p, d(:, 1), d(:, 2)), start + [shift, 0], [], [], options);
        if cost < best, best = cost; q = p; jac = full(J); end
    end
    sd = sqrt(diag(inv(jac' * jac)) * best / (size(d, 1) - 4))';
    a = exp([q', (q - 1.96 * sd)', (q + 1.96 * sd)']);
end

function r = misfit(p, t, x)
    w = sqrt(max(exp(p(1)) - exp(2 * p(2)) / 4, 1e-12));
    B = exp(-exp(p(2)) / 2 * t) .* [cos(w * t), sin(w * t)];
    r = B * (B \ x) - x;
end
